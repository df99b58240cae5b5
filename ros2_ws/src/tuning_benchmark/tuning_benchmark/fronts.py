"""Pareto fronts compared: ``python -m tuning_benchmark.fronts``.

The tuner's algorithms and Optuna's samplers for several objectives, with equally many trials and
evaluations in each, on problems whose front under the robust limit is known
(`problems.two_objectives`). Each front that an optimizer recommends is judged by the hypervolume of
the true costs of its points, relative to that of the true front; a point that violates the limit in
truth counts nothing. Runs with the same seed share their initial design. The record becomes a
section of the page that ``benchmark`` writes.
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
from tuning_benchmark.pages.fronts import RECORD
from tuning_benchmark.peers.adapter import peer_method
from tuning_benchmark.peers.optuna_fronts import OptunaFront, nsga2, tpe
from tuning_benchmark.problems.two_objectives import TwoObjectives

PARAMETERS = (2, 4)
"""Of the problems."""
PEERS: dict[str, Callable[[Study, int], OptunaFront]] = {"NSGA-II": nsga2, "TPE": tpe}
OURS = ("boundary", "IV", "II")


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
            trials = list(Tuning(study, Driver(backend), peer_method(peer)))
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


def make_parser() -> argparse.ArgumentParser:
    """Make the parser of the command line."""
    parser = argparse.ArgumentParser(prog="python -m tuning_benchmark.fronts", description=__doc__)
    parser.add_argument("--runs", type=int, default=10, metavar="N")
    parser.add_argument(
        "--records", type=Path, required=True, metavar="DIR", help=f"folder for {RECORD}"
    )
    return parser


def main(arguments: Sequence[str]) -> None:
    """Run all, and write the record."""
    parser = make_parser()
    options = parser.parse_args(arguments)
    if options.runs < 2:
        parser.error(f"--runs: expected at least 2, found {options.runs}")
    # A folder that cannot be made is found out ahead of the measurement, which takes long.
    options.records.mkdir(parents=True, exist_ok=True)
    record = _measure(options.runs)
    (options.records / RECORD).write_text(json.dumps(record, indent=1) + "\n", encoding="utf-8")


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
            by_optimizer: dict[str, list[dict[str, Any]]] = {}
            for name in (*OURS, *PEERS):
                judged = [
                    vars(run(TwoObjectives(parameters), name, seed)) for seed in range(1, runs + 1)
                ]
                by_optimizer[name] = judged
                sys.stderr.write(
                    f"{parameters} parameters, {name}: "
                    f"{np.mean([item['volume'] for item in judged]):.3f}\n"
                )
            record["problems"][str(parameters)] = by_optimizer
    return record


if __name__ == "__main__":
    main(sys.argv[1:])
