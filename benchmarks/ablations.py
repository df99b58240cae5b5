"""What each choice of the algorithm `boundary` is worth: without it, with the same seeds.

The runs and their judge are those of a case of the experiment `boundary`. A difference is taken
between runs with the same seed: those in which only one of both has a truly feasible answer, with
the exact test of McNemar (1947), and the difference of the true objective where both have one, with
Student's t interval.
"""

import os
import time
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import ExitStack
from dataclasses import dataclass, field
from types import ModuleType
from typing import Any
from unittest.mock import patch

# Before the libraries that read it.
os.environ.update(OPENBLAS_NUM_THREADS="1")

from common import provenance, result_parser, table, write_result

from bo_tuner.models import fitting, joint_process
from bo_tuner.optimizers import boundary
from tuning_benchmark.campaign import runs
from tuning_benchmark.experiments.experiment import Row
from tuning_benchmark.experiments.experiment_file import load_experiment
from tuning_benchmark.judging.truth import FEW_REAL_EVALUATIONS, truth_of
from tuning_benchmark.pages.statistics import difference, mcnemar, mean

Change = tuple[ModuleType, str, Any]
ROW = Row(name="boundary", algorithm="boundary")


@dataclass(frozen=True)
class Variant:
    """The algorithm with other values of names in modules, or keys of the budget."""

    title: str
    changes: Sequence[Change] = ()
    budget: Mapping[str, int] = field(default_factory=dict)
    cases: Sequence[str] = ("mean",)


def _all(_: object, evaluations: int) -> int:
    return evaluations


VARIANTS = (
    Variant("as shipped", cases=("mean", "single-run")),
    Variant("no repetitions: all evaluations for trials", ((runs, "before_repetitions", _all),)),
    Variant("search to the end of the trials", ((boundary, "SEARCHING", 1.0),)),
    Variant("no search: boundary from the initial design on", ((boundary, "SEARCHING", 0.0),)),
    Variant("points to be shown feasible by 2 runs, not 8", ((boundary, "AHEAD", 2),)),
    Variant(
        "equal noise everywhere",
        ((joint_process, "WIDTH", 1e3),),
        cases=("mean", "single-run"),
    ),
    Variant("fits continue only, never start anew", ((joint_process, "RESTARTED", 0),)),
    Variant(
        "worst contexts at the corners and the hypercube only",
        ((fitting, "searched_contexts", lambda _: ()),),
    ),
    Variant(
        "5 drawn contexts and 10 searched, as in the paper, for each trial of the search",
        budget={"drawn_contexts": 5, "search_evaluations": 10},
    ),
)


def run(case_name: str, index: int, seed: int) -> dict[str, Any]:
    """Run one variant with one seed and judge its answer."""
    variant, experiment = VARIANTS[index], load_experiment("boundary")
    case = experiment.cases[case_name]
    study = case.study.replace(**variant.budget)
    size = runs.RunSize(case.evaluations, 0, study.budget.initial_trials)
    begin = time.process_time()
    with ExitStack() as stack:
        for module, name, value in variant.changes:
            stack.enter_context(patch.object(module, name, value))
        tuning = runs.Run(study, ROW, seed, size)
        for _ in tuning:
            pass
        answer = tuning.answer()
    found: dict[str, Any] = {
        "seed": seed,
        "trials": len(tuning.trials),
        "evaluations": tuning.backend.evaluations,
        "seconds": round(time.process_time() - begin, 1),
        "believed": answer is not None and answer[1],
        "feasible": False,
    }
    if answer is not None:
        truth = truth_of(study, experiment.judge)
        verdict = truth.verdict(tuning.trials[answer[0]].parameters, FEW_REAL_EVALUATIONS)
        found |= {
            "feasible": verdict.feasible,
            "objective": verdict.objective,
            "worst": verdict.worst,
        }
    return found


def compare(
    found: Sequence[Mapping[str, Any]], shipped: Sequence[Mapping[str, Any]]
) -> dict[str, Any]:
    """Return counts, mean objective and evaluations, and the paired difference to the shipped."""
    feasible = {r["seed"]: r["objective"] for r in found if r["feasible"]}
    reference = {r["seed"]: r["objective"] for r in shipped if r["feasible"]}
    less = difference(feasible, reference)
    only, only_shipped = len(feasible.keys() - reference), len(reference.keys() - feasible)
    return {
        "runs": len(found),
        "feasible": len(feasible),
        "objective": mean(list(feasible.values())).value if feasible else None,
        "evaluations": mean([r["evaluations"] for r in found]).value,
        "only": only,
        "only_shipped": only_shipped,
        "mcnemar": mcnemar(only, only_shipped),
        "difference": [less.value, less.low, less.high] if less.count > 1 else None,
    }


def main() -> None:
    """Run all variants and report."""
    parser = result_parser(__doc__, "ablations.json")
    parser.add_argument("--runs", type=int, default=20, help="seeds (default: %(default)s)")
    parser.add_argument("--jobs", type=int, default=1, help="processes (default: %(default)s)")
    arguments = parser.parse_args()
    about = provenance() | {"seeds": list(range(1, arguments.runs + 1))}
    cases: dict[str, Any] = {}
    rows = []
    with ProcessPoolExecutor(arguments.jobs) as pool:
        for index, variant in enumerate(VARIANTS):
            for case in variant.cases:
                pending = [pool.submit(run, case, index, seed) for seed in about["seeds"]]
                found = [item.result() for item in pending]
                entry = cases.setdefault(
                    case, {"title": load_experiment("boundary").cases[case].title, "variants": {}}
                )
                shipped = entry["variants"].get("as shipped", {"results": found})["results"]
                summary = compare(found, shipped)
                entry["variants"][variant.title] = {"results": found} | summary
                rows.append([case, variant.title, summary["feasible"], summary["objective"]])
                print(f"{case}: {variant.title}: {summary}", flush=True)
                write_result(arguments.result, {"provenance": about, "cases": cases})
    print(table(["case", "variant", "feasible", "objective"], rows))


if __name__ == "__main__":
    main()
