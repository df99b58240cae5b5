"""What each choice of the algorithm `boundary` is worth: without it, with the same seeds.

The runs and their judge are those of a case of an experiment, or of `wide_ranges.py`: a few trials
in wide ranges. A difference is taken between runs with the same seed: those in which only one of
both has a truly feasible answer, with the exact test of McNemar (1947), and the difference of the
true objective where both have one, with Student's t interval.

Each case has the commit and machine that it was run with; `--cases` runs some of them again.
"""

import os
import time
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field, replace
from typing import Any

# Before the libraries that read it.
os.environ.update(OPENBLAS_NUM_THREADS="1")

import wide_ranges
from common import provenance, read_result, result_parser, table, write_result

from bo_tuner.methods.boundary.approach import Approach
from bo_tuner.methods.boundary.exploration import Exploration
from bo_tuner.methods.boundary.method import Boundary
from bo_tuner.methods.boundary.repetition import OwnRuns
from bo_tuner.methods.boundary.settling import Repetitions
from bo_tuner.methods.boundary.stage_one import AdaptedAvoidance, Schedule
from bo_tuner.models.compression import Compression
from bo_tuner.models.pooled_models import PooledModels
from bo_tuner.models.pooled_process import PooledProcesses
from bo_tuner.numerics.arrays import Array
from bo_tuner.trials import TrialState
from tuning_benchmark.campaign import runs
from tuning_benchmark.experiments.experiment import Experiment
from tuning_benchmark.experiments.experiment_file import load_experiment
from tuning_benchmark.judging.truth import FEW_REAL_EVALUATIONS, truth_of
from tuning_benchmark.pages.statistics import difference, mcnemar, mean

ROW = "boundary"
EXPERIMENTS = {
    "mean": "boundary",
    "single-run": "boundary",
    "closed-4-2": "closed_form",
    "closed-4-2-steep": "closed_form",
    "closed-4-3-crash": "closed_form",
    "basins-2": "exploration",
}
"""Experiment of each case but `WIDE`."""

WIDE = "wide"
CASES = (*EXPERIMENTS, WIDE)

SHIPPED = "as shipped"


BOUNDARY = Boundary()


@dataclass(frozen=True)
class Variant:
    """The method with other parts, or other keys of the budget."""

    title: str
    method: Boundary = BOUNDARY
    budget: Mapping[str, Any] = field(default_factory=dict)
    cases: Sequence[str] = ("mean",)


def _as_it_is(_: Array, limit: float, sign: float) -> Compression:
    return Compression(limit, sign)


VARIANTS = (
    Variant(SHIPPED, cases=CASES),
    Variant(
        "no repetitions: all evaluations for trials",
        replace(BOUNDARY, repetitions=Repetitions(share=0.0)),
    ),
    Variant("search to the end of the trials", replace(BOUNDARY, schedule=Schedule(1.0))),
    Variant(
        "no search: boundary from the initial design on",
        replace(BOUNDARY, schedule=Schedule(0.0)),
    ),
    Variant("points to be shown feasible by 2 runs, not 8", replace(BOUNDARY, ahead=2)),
    Variant(
        "equal noise everywhere",
        replace(BOUNDARY, models=PooledModels(PooledProcesses(width=1e3))),
        cases=("mean", "single-run"),
    ),
    Variant(
        "fits continue only, never start anew",
        replace(BOUNDARY, models=PooledModels(PooledProcesses(restarted=0))),
    ),
    Variant(
        "worst contexts at the corners and the hypercube only",
        replace(BOUNDARY, models=PooledModels(looked=lambda _: ())),
    ),
    Variant(
        "5 drawn contexts and 10 searched, as in the paper, for each trial of the search",
        budget={"drawn_contexts": 5, "search_evaluations": 10},
    ),
    Variant(
        "up to a third as many repetitions as evaluations of the trials, not a sixth",
        replace(BOUNDARY, repetitions=Repetitions(share=1.0 / 3.0)),
        cases=("mean", "closed-4-2"),
    ),
    Variant(
        "answer without runs of its own",
        replace(BOUNDARY, own_runs=OwnRuns(doubtful=0, corners=0)),
        cases=("mean", "closed-4-2"),
    ),
    Variant(
        "answer not run in the corners of the contexts",
        replace(BOUNDARY, own_runs=OwnRuns(corners=0)),
        cases=("closed-4-2", "closed-4-2-steep"),
    ),
    Variant(
        "limited metrics modelled as they are, however far beyond the limit",
        replace(BOUNDARY, models=PooledModels(scale=_as_it_is)),
        cases=("closed-4-2-steep",),
    ),
    Variant(
        "probability of a crash at most a tenth, not adapted",
        replace(BOUNDARY, avoidance=AdaptedAvoidance(adaptation=0.0)),
        cases=("closed-4-3-crash",),
    ),
    Variant(
        "any probability of a crash",
        replace(BOUNDARY, avoidance=lambda *_: 1.0),
        cases=("closed-4-3-crash",),
    ),
    Variant(
        "a first feasible parameter set searched in the whole cube",
        replace(BOUNDARY, approach=Approach(half_width=1.0)),
        cases=("closed-4-2-steep", WIDE),
    ),
    Variant(
        "no trial elsewhere than where improvement is expected",
        replace(BOUNDARY, exploration=Exploration(until=0.0)),
        cases=("basins-2",),
    ),
)


def title_of(case: str) -> str:
    """Return the title of a case."""
    if case == WIDE:
        return wide_ranges.TITLE
    return load_experiment(EXPERIMENTS[case]).cases[case].title


def run(case_name: str, index: int, seed: int) -> dict[str, Any]:
    """Run one variant with one seed and judge its answer."""
    variant = VARIANTS[index]
    if case_name == WIDE:
        return wide_ranges.run(wide_ranges.wide_study(), seed, variant.method)
    return judged(load_experiment(EXPERIMENTS[case_name]), case_name, variant, seed)


def judged(
    experiment: Experiment, case_name: str, variant: Variant, seed: int, window: int = 1
) -> dict[str, Any]:
    """Run a variant of `boundary` on a case, with so many trials at once, and judge its answer."""
    case = experiment.cases[case_name]
    study = case.study.replace(**variant.budget)
    size = runs.RunSize(case.evaluations, 0, study.budget.initial_trials)
    begin = time.process_time()
    tuning = runs.Run(study, case.rows[ROW], seed, size, variant.method, window=window)
    for _ in tuning:
        pass
    answer = tuning.answer()
    found: dict[str, Any] = {
        "seed": seed,
        "trials": len(tuning.trials),
        "failed": sum(t.state is TrialState.FAILED for t in tuning.trials),
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
    """Return counts and means, and the paired difference of the objective to the shipped."""
    feasible = {r["seed"]: r["objective"] for r in found if r["feasible"]}
    reference = {r["seed"]: r["objective"] for r in shipped if r["feasible"]}
    less = difference(feasible, reference)
    only, only_shipped = len(feasible.keys() - reference), len(reference.keys() - feasible)
    return {
        "runs": len(found),
        "feasible": len(feasible),
        "objective": mean(list(feasible.values())).value if feasible else None,
        "evaluations": mean([r["evaluations"] for r in found]).value,
        "failed": mean([r["failed"] for r in found]).value,
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
    parser.add_argument("--cases", nargs="+", choices=CASES, default=CASES)
    arguments = parser.parse_args()
    about = provenance() | {"seeds": list(range(1, arguments.runs + 1))}
    known = read_result(arguments.result)
    cases = known["cases"] if known else {}
    rows = []
    with ProcessPoolExecutor(arguments.jobs) as pool:
        for case in arguments.cases:
            entry: dict[str, Any] = {"provenance": about, "title": title_of(case), "variants": {}}
            for index, variant in enumerate(VARIANTS):
                if case not in variant.cases:
                    continue
                pending = [pool.submit(run, case, index, seed) for seed in about["seeds"]]
                found = [item.result() for item in pending]
                shipped = entry["variants"].get(SHIPPED, {"results": found})["results"]
                summary = compare(found, shipped)
                entry["variants"][variant.title] = {"results": found} | summary
                rows.append([case, variant.title, summary["feasible"], summary["objective"]])
                print(f"{case}: {variant.title}: {summary}", flush=True)
            cases[case] = entry
            write_result(arguments.result, {"cases": {c: cases[c] for c in CASES if c in cases}})
    print(table(["case", "variant", "feasible", "objective"], rows))


if __name__ == "__main__":
    main()
