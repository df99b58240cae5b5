"""Judge what an algorithm recommends: many runs of a study, each answer against the truth.

Every seed is a whole run on the in-process backend, as `tune` does it: trials, checks of the best
candidates on fresh draws, validation. The recommendation is then judged by `truth.py`, as the
optimum of `grid_search.py` was. A run that ended is a line of the ``.jsonl`` file, so that a
campaign goes on where it stopped; a campaign never mixes versions of the code.

Seconds are processor seconds of the trials, cuts included.

  python benchmarks/optimizer_quality.py --algorithm IV --trials 40 --seeds 20
  python benchmarks/optimizer_quality.py --algorithm V --cuts 500 --seeds 10

The summary below the table compares the mean with the best grid point.
"""

import argparse
import dataclasses
import json
import time
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path
from typing import Any

import numpy as np
from common import RESULTS, provenance, source_digest, table, write_result
from grid_search import TOLERABLE
from threadpoolctl import threadpool_limits
from truth import SEED, Effort, Truth

from bo_tuner.backends.inprocess import InProcessBackend
from bo_tuner.confirmation import recommend
from bo_tuner.methods import METHODS, Method
from bo_tuner.study import Study
from bo_tuner.study_file import load_study
from bo_tuner.trials import Trial, TrialState, Value
from bo_tuner.tuning import Tuning
from bo_tuner.validation import validate
from mpc_controller.errors import ControllerError

MOST_TRIALS = 300
"""Trials of a run that is bounded by its cuts."""


@dataclasses.dataclass(frozen=True)
class Campaign:
    """What is run for every seed.

    Attributes
    ----------
    study, algorithm
        As the options of the command.
    trials
        Parametrizations of a run.
    cuts
        If given, a run ends with the trial that reaches so many cuts.
    worst_case, neighbour_starts
        If given, instead of the algorithm's own.
    """

    study: str
    algorithm: str
    trials: int | None = None
    cuts: int | None = None
    worst_case: str | None = None
    neighbour_starts: int | None = None

    def method(self) -> Method:
        """Make the algorithm with the changed choices."""
        method = METHODS[self.algorithm]
        if self.worst_case is not None:
            method = dataclasses.replace(method, worst_case=self.worst_case)
        if self.neighbour_starts is not None:
            method = dataclasses.replace(method, neighbour_starts=self.neighbour_starts)
        return method

    def seeded(self, seed: int) -> Study:
        """Make the study of one run."""
        trials = self.trials if self.cuts is None else MOST_TRIALS
        return load_study(self.study).replace(seed=seed, trials=trials)

    def name(self) -> str:
        """Name of the result file."""
        study = load_study(self.study)
        parts = [study.name, self.algorithm]
        if self.cuts is not None:
            parts.append(f"{self.cuts}cuts")
        else:
            parts.append(f"{self.trials or study.budget.trials}trials")
        if self.worst_case is not None:
            parts.append(self.worst_case)
        if self.neighbour_starts is not None:
            parts.append(f"{self.neighbour_starts}starts")
        return "-".join(parts)


def run(campaign: Campaign, seed: int) -> dict[str, Any]:
    """Run the study with one seed and judge the answer."""
    threadpool_limits(1)
    study, method = campaign.seeded(seed), campaign.method()
    backend = InProcessBackend(study)
    backend.open()
    cuts = {"tuning": 0, "checks": 0}
    begin = time.process_time()
    tuning = Tuning(study, backend, method)
    for trial in tuning:
        cuts["tuning"] += len(trial.cuts)
        if campaign.cuts is not None and cuts["tuning"] >= campaign.cuts:
            break
    seconds = time.process_time() - begin

    def count(cut: object, parameters: object) -> None:
        cuts["checks"] += 1

    answer = recommend(study, backend, tuning.trials, options=method.models, observe=count)
    record: dict[str, Any] = {
        "seed": seed,
        "trials": len(tuning.trials),
        "failed_trials": sum(t.state is TrialState.FAILED for t in tuning.trials),
        "warnings": sum(len(t.warnings) for t in tuning.trials),
        "cuts": cuts["tuning"],
        "check_cuts": cuts["checks"],
        "seconds": round(seconds, 2),
    }
    if answer is None:
        return record | {"parameters": None}
    candidate = answer.candidate
    parameters = dict(candidate.trial.parameters)
    (checked,) = validate(study, backend, [parameters])
    truth = Truth(study)
    judgement = truth.judge(parameters)
    chances, shares = truth.meets_chances(parameters)
    return record | {
        "parameters": parameters,
        "trial": candidate.trial.number,
        "said_feasible": answer.feasible,
        "checked": list(answer.checked),
        "predicted_E": candidate.objective,
        "validated": answer.feasible and checked.feasible,
        "validation_E": checked.objective,
        **dataclasses.asdict(judgement),
        "within_limits": shares,
        "feasible": judgement.worst <= truth.limit and chances,
        "feasible_precise": judgement.worst_precise <= truth.limit and chances,
        "narrow": is_narrow(truth, parameters, judgement.E),
        "best_tried_E": best_tried(truth, tuning.trials),
    }


def is_narrow(truth: Truth, parameters: dict[str, Value], E: float) -> bool:
    """Whether one integer step away limit or E is exceeded by over a fifth (see grid_search)."""
    for neighbour in truth.study.search_space().integer_neighbours(parameters):
        try:
            C, _ = truth.drawn(neighbour)
            worst = float(truth.grid_overshoot(neighbour).max())
        except ControllerError:
            return True
        if not (worst <= (1 + TOLERABLE) * truth.limit and C.mean() <= (1 + TOLERABLE) * E):
            return True
    return False


def best_tried(truth: Truth, trials: list[Trial]) -> float | None:
    """Lowest true E of all truly feasible parametrizations that a run tried."""
    found = []
    for trial in trials:
        parameters = trial.parameters
        if (
            trial.state is TrialState.COMPLETE
            and truth.corner_overshoot(parameters) <= truth.limit
            and truth.grid_overshoot(parameters).max() <= truth.limit
        ):
            found.append(float(truth.drawn(parameters)[0].mean()))
    return min(found, default=None)


def conduct(campaign: Campaign, seeds: list[int], jobs: int, path: Path) -> list[dict[str, Any]]:
    """Run the seeds that the campaign's file does not hold yet; returns the records of all."""
    head = dataclasses.asdict(campaign) | {"source_digest": source_digest()}
    records: dict[int, dict[str, Any]] = {}
    if path.exists():
        lines = [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]
        if not lines or lines[0] != head:
            raise SystemExit(
                f"error: {path} is of another campaign or version of the code; remove it or give "
                "another --output"
            )
        records = {line["seed"]: line for line in lines[1:]}
    else:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(head) + "\n", encoding="utf-8")
    missing = [seed for seed in seeds if seed not in records]
    with ProcessPoolExecutor(jobs) as pool, path.open("a", encoding="utf-8") as file:
        for future in as_completed([pool.submit(run, campaign, seed) for seed in missing]):
            record = future.result()
            records[record["seed"]] = record
            file.write(json.dumps(record) + "\n")
            file.flush()
    return [records[seed] for seed in seeds]


def summarise(records: list[dict[str, Any]], optimum: float | None) -> dict[str, Any]:
    """Sum up all runs; numbers of E over the runs with an answer, feasible or not."""
    answered = [r for r in records if r["parameters"] is not None]

    def column(key: str) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
        values = [r[key] for r in answered if r[key] is not None]
        return np.array(values, dtype=np.float64)

    E = column("E")
    summary: dict[str, Any] = {
        "runs": len(records),
        "answered": len(answered),
        "said_feasible": int(column("said_feasible").sum()),
        "validated": int(column("validated").sum()),
        "feasible": int(column("feasible").sum()),
        "feasible_precise": int(column("feasible_precise").sum()),
        "narrow": int(column("narrow").sum()),
        "E_mean": float(E.mean()),
        "E_min": float(E.min()),
        "E_max": float(E.max()),
        "worst_mean": float(column("worst").mean()),
        "worst_max": float(column("worst").max()),
        "best_tried_E_mean": float(column("best_tried_E").mean()),
        "cuts_mean": float(np.mean([r["cuts"] for r in records])),
        "check_cuts_mean": float(column("check_cuts").mean()),
        "seconds_mean": float(np.mean([r["seconds"] for r in records])),
    }
    if optimum is not None:
        summary["optimum_E"] = optimum
        summary["distance_percent"] = 100.0 * (float(E.mean()) / optimum - 1.0)
    return summary


def grid_optimum(name: str) -> float | None:
    """E of a study's grid optimum, if it was searched."""
    path = RESULTS / "grid_search.json"
    if not path.exists():
        return None
    entries = json.loads(path.read_text(encoding="utf-8"))
    return float(entries[name]["optimum"]["E"]) if name in entries else None


COLUMNS = (
    "seed",
    "E",
    "worst",
    "worst_precise",
    "feasible",
    "validated",
    "said_feasible",
    "narrow",
    "predicted_E",
    "best_tried_E",
    "cuts",
    "check_cuts",
    "seconds",
)


def report(records: list[dict[str, Any]], names: tuple[str, ...]) -> str:
    """Lay out a table, a line per run."""
    rows = []
    for record in records:
        parameters = record["parameters"]
        values = [parameters[name] for name in names] if isinstance(parameters, dict) else []
        shown = values or ["-"] * len(names)
        rows.append([*(record.get(column, "-") for column in COLUMNS), *shown])
    return table([*COLUMNS, *names], rows)


def make_parser() -> argparse.ArgumentParser:
    """Make the parser of the command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--study", default="benchmark", metavar="NAME|FILE")
    parser.add_argument("--algorithm", choices=tuple(METHODS), default="IV")
    parser.add_argument("--trials", type=int, help="trials of a run (default: the study's)")
    parser.add_argument("--cuts", type=int, help="end a run by its cuts instead of its trials")
    parser.add_argument("--seeds", type=int, default=20, help="runs, with seeds from 1 on")
    parser.add_argument("--first-seed", type=int, default=1)
    parser.add_argument("--jobs", type=int, default=2, help="processes (default: %(default)s)")
    parser.add_argument("--worst-case", choices=("observed", "posterior"))
    parser.add_argument("--neighbour-starts", type=int)
    parser.add_argument(
        "--output", type=Path, default=RESULTS, help="folder (default: %(default)s)"
    )
    return parser


def main() -> None:
    """Run the command."""
    arguments = make_parser().parse_args()
    campaign = Campaign(
        study=arguments.study,
        algorithm=arguments.algorithm,
        trials=arguments.trials,
        cuts=arguments.cuts,
        worst_case=arguments.worst_case,
        neighbour_starts=arguments.neighbour_starts,
    )
    stem = arguments.output / f"quality-{campaign.name()}"
    seeds = list(range(arguments.first_seed, arguments.first_seed + arguments.seeds))
    about = provenance() | {"effort": dataclasses.asdict(Effort()), "truth_seed": SEED}
    records = conduct(campaign, seeds, arguments.jobs, stem.with_suffix(".jsonl"))
    study = load_study(campaign.study)
    summary = summarise(records, grid_optimum(study.name))
    write_result(
        stem.with_suffix(".json"),
        {
            "campaign": dataclasses.asdict(campaign),
            "summary": summary,
            "runs": records,
            "provenance": about | {"seeds": seeds},
        },
    )
    print(campaign.name())
    print(report(records, study.search_space().names))
    print("\n".join(f"{key}: {_shown(value)}" for key, value in summary.items()))


def _shown(value: object) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)


if __name__ == "__main__":
    main()
