"""Pareto fronts compared: ``python -m tuning_benchmark.fronts``.

The tuner's algorithms and Optuna's samplers for several objectives, with equally many trials and
evaluations in each, on problems whose front under the robust limit is known
(`problems.two_objectives`). Each front that an optimizer recommends is judged by the hypervolume of
the true costs of its points, relative to that of the true front; a point that violates the limit in
truth counts nothing. Runs with the same seed share their initial design.
"""

import argparse
import contextlib
import json
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from bo_tuner.backends.inprocess import InProcessBackend
from bo_tuner.methods.registry import METHODS
from bo_tuner.study.study import Study
from bo_tuner.trials import Trial, count_evaluations
from bo_tuner.tuning.driver import Driver
from bo_tuner.tuning.front import pareto_front
from bo_tuner.tuning.loop import Tuning
from tuning_benchmark.campaign import provenance
from tuning_benchmark.pages.statistics import Mean, difference, mean
from tuning_benchmark.peers.adapter import peer_method
from tuning_benchmark.peers.optuna_fronts import POPULATION, OptunaFront, nsga2, tpe
from tuning_benchmark.problems.two_objectives import TwoObjectives

RECORD, PAGE = "fronts.json", "fronts.md"
PARAMETERS = (2, 4)
"""Of the problems."""
PEERS: dict[str, Callable[[Study, int], OptunaFront]] = {"NSGA-II": nsga2, "TPE": tpe}
OURS = ("IV", "II")
TITLES = {
    "IV": "Algorithm IV, ParEGO weights",
    "II": "random search (Algorithm II)",
    "NSGA-II": f"Optuna NSGA-II, population {POPULATION}",
    "TPE": "Optuna TPE",
}


@dataclass(frozen=True)
class Run:
    """What came of a run.

    Attributes
    ----------
    seed
        Of the study.
    trials, evaluations
        How many it had.
    points, violating
        Points of the front that it recommends, and those of them that violate the limit in truth.
    volume
        Hypervolume of these points, relative to that of the true front.
    seen
        The same of all its trials, that is without the mistakes of the recommendation.
    """

    seed: int
    trials: int
    evaluations: int
    points: int
    violating: int
    volume: float
    seen: float


def run(problem: TwoObjectives, name: str, seed: int) -> Run:
    """Run an optimizer, one of `TITLES`, and judge its front."""
    study = problem.study().replace(seed=seed)
    backend = InProcessBackend(study)
    backend.open()
    with contextlib.closing(backend):
        if name in PEERS:
            peer = PEERS[name](study, seed)
            # The second stage is the same for all.
            method = peer_method(TITLES[name], peer)
            trials = list(Tuning(study, Driver(backend), method))
            front = peer.recommend()
        else:
            trials = list(Tuning(study, Driver(backend), METHODS[name]))
            ranked = METHODS[name].ranking.rank(study, trials)
            front = [point.trial for point in pareto_front(study, ranked)]
    return _judged(problem, seed, trials, front)


def _judged(problem: TwoObjectives, seed: int, trials: list[Trial], front: list[int]) -> Run:
    points = np.array([problem.point(trial.parameters) for trial in trials])
    worst = problem.worst(points[front])
    return Run(
        seed=seed,
        trials=len(trials),
        evaluations=count_evaluations(trials),
        points=len(front),
        violating=int((worst > problem.study().constraints["share"].limit).sum()),
        volume=problem.volume(points[front]),
        seen=problem.volume(points),
    )


def table(problem: TwoObjectives, found: dict[str, list[dict[str, Any]]]) -> str:
    """Return the table of a problem in Markdown."""
    lines = [
        "| optimizer | hypervolume of the front | Algorithm IV minus it | of all trials | points | "
        "violating, in all runs | evaluations |",
        "|---|---|---|---|---|---|---|",
    ]
    first = {item["seed"]: item["volume"] for item in found[OURS[0]]}
    for name, runs in found.items():
        volumes = {item["seed"]: item["volume"] for item in runs}
        versus = "–" if name == OURS[0] else _shown(difference(first, volumes))
        cells = [
            TITLES[name],
            _shown(mean(list(volumes.values()))),
            versus,
            _shown(mean([item["seen"] for item in runs])),
            f"{np.mean([item['points'] for item in runs]):.1f}",
            f"{sum(item['violating'] for item in runs)}",
            f"{np.mean([item['evaluations'] for item in runs]):.0f}",
        ]
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


def _shown(found: Mean) -> str:
    return f"{found.value:.3f} ± {found.high - found.value:.3f}"


def page(record: dict[str, Any]) -> str:
    """Return the page in Markdown."""
    about = record["provenance"]
    parts = [
        "# Pareto fronts compared",
        "Written by `python -m tuning_benchmark.fronts` from its record; do not edit.",
        "Two objectives under a robust limit, with noise and two contexts "
        "([two_objectives.py](../ros2_ws/src/tuning_benchmark/tuning_benchmark/problems/"
        "two_objectives.py)). All optimizers have the same initial design, number of trials and "
        "second stage. The hypervolume is that of the true costs of the points that an optimizer "
        "recommends, relative to the true front: 1 is all of it, and a finite number of points "
        "always leaves something. A point that violates the limit in truth counts nothing. ± is "
        "half the width of a 95 % interval; differences are of runs with the same seed.",
    ]
    for parameters, found in record["problems"].items():
        problem = TwoObjectives(int(parameters))
        runs = len(found[OURS[0]])
        trials = found[OURS[0]][0]["trials"]
        parts += [
            f"## {parameters} parameters",
            f"{runs} runs of each, {trials} trials.",
            table(problem, found),
        ]
    parts.append(
        f"Commit {about['commit']}, seeds 1 to {record['runs']}; {about['machine']}; "
        f"{', '.join(about['versions'])}."
    )
    return "\n\n".join(parts) + "\n"


def make_parser() -> argparse.ArgumentParser:
    """Make the parser of the command line."""
    parser = argparse.ArgumentParser(prog="python -m tuning_benchmark.fronts", description=__doc__)
    parser.add_argument("--runs", type=int, default=10, metavar="N")
    parser.add_argument("--output", type=Path, required=True, metavar="DIR", help=f"of {PAGE}")
    parser.add_argument(
        "--records", type=Path, metavar="DIR", help=f"of {RECORD} (default: the output folder)"
    )
    parser.add_argument("--page-only", action="store_true", help="write the page from the record")
    return parser


def main(arguments: Sequence[str]) -> None:
    """Run all, and write record and page."""
    parser = make_parser()
    options = parser.parse_args(arguments)
    if options.runs < 2:
        parser.error(f"--runs: expected at least 2, found {options.runs}")
    path = (options.records or options.output) / RECORD
    # A folder that cannot be made is found out ahead of the measurement, which takes long.
    for folder in (options.output, path.parent):
        folder.mkdir(parents=True, exist_ok=True)
    if options.page_only:
        record = json.loads(path.read_text(encoding="utf-8"))
    else:
        record = _measure(options.runs)
        path.write_text(json.dumps(record, indent=1) + "\n", encoding="utf-8")
    (options.output / PAGE).write_text(page(record), encoding="utf-8")


def _measure(runs: int) -> dict[str, Any]:
    # The command itself is called __main__.
    root = ["tuning_benchmark.fronts"]
    record: dict[str, Any] = {
        "runs": runs,
        "provenance": {
            "commit": provenance.commit(root),
            "versions": provenance.versions(root),
            "machine": provenance.machine(),
        },
        "problems": {},
    }
    with threadpool_limits(1):
        for parameters in PARAMETERS:
            found: dict[str, list[dict[str, Any]]] = {}
            for name in (*OURS, *PEERS):
                judged = [
                    vars(run(TwoObjectives(parameters), name, seed)) for seed in range(1, runs + 1)
                ]
                found[name] = judged
                sys.stderr.write(
                    f"{parameters} parameters, {name}: "
                    f"{np.mean([item['volume'] for item in judged]):.3f}\n"
                )
            record["problems"][str(parameters)] = found
    return record


if __name__ == "__main__":
    main(sys.argv[1:])
