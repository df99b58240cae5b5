"""Answers of `boundary` to problems of many kinds, by the truth.

The runs are those of cases of the experiments, in one process, each with seeds 1, 2, ...; of each
case it reports the truly feasible answers, their regret, and the realized probability of a run
within the limit in its worst context. `--against` takes the result file of another installation
with the same seeds; the table then has the paired differences.
"""

import os
import time
from collections.abc import Mapping, Sequence
from typing import Any

# Before the libraries that read it.
os.environ.update(OPENBLAS_NUM_THREADS="1")

from pathlib import Path

import numpy as np
from common import provenance, read_result, result_parser, table, write_result

from tuning_benchmark.campaign import runs
from tuning_benchmark.experiments.experiment import Case, Experiment
from tuning_benchmark.experiments.experiment_file import load_experiment
from tuning_benchmark.judging.truth import truth_of
from tuning_benchmark.pages.statistics import difference, mcnemar

ROW = "boundary"
EXPERIMENTS = ("noise", "exploration", "kinds", "closed_form")


def cases_by_name() -> dict[str, tuple[Experiment, Case]]:
    """Return all cases with a row of `boundary`, with their experiments."""
    loaded = [load_experiment(name) for name in EXPERIMENTS]
    return {name: (e, case) for e in loaded for name, case in e.cases.items()}


def run(experiment: Experiment, case: Case, seed: int) -> dict[str, Any]:
    """Run a case with one seed and judge its answer."""
    begin = time.process_time()
    size = runs.RunSize(case.evaluations, 0, case.study.budget.initial_trials)
    tuning = runs.Run(case.study, case.rows[ROW], seed, size)
    for _ in tuning:
        pass
    answer = tuning.answer()
    found = {
        "seed": seed,
        "trials": len(tuning.trials),
        "seconds": round(time.process_time() - begin, 1),
        "believed": answer is not None and answer[1],
        "feasible": False,
    }
    optimum = experiment.optimum(case.study)
    if answer is not None and optimum is not None:
        truth = truth_of(case.study, experiment.judge)
        verdict = truth.verdict(tuning.trials[answer[0]].parameters)
        found |= {
            "feasible": verdict.feasible,
            "regret": verdict.objective / optimum.objective - 1.0,
            "worst": verdict.worst,
            "kept": verdict.worst_kept,
        }
    return found


def summary(found: Sequence[Mapping[str, Any]]) -> list[Any]:
    """Return counts, and medians of the truly feasible answers, as cells of the table."""
    feasible = [r for r in found if r["feasible"]]
    regret = [r["regret"] for r in feasible]
    kept = [r["kept"] for r in found if "kept" in r]
    return [
        len(found),
        len(feasible),
        f"{np.median(regret):.1%}" if regret else "-",
        f"{np.mean(regret):.1%}" if regret else "-",
        f"{np.mean(kept):.3f}" if np.isfinite(kept).any() else "-",
        f"{np.mean([r['seconds'] for r in found]):.1f}",
    ]


def paired(found: Sequence[Mapping[str, Any]], before: Sequence[Mapping[str, Any]]) -> list[Any]:
    """Return the runs of which only one of both is feasible, and the difference of the regret."""
    now = {r["seed"]: r["regret"] for r in found if r["feasible"]}
    then = {r["seed"]: r["regret"] for r in before if r["feasible"]}
    only, only_before = len(now.keys() - then), len(then.keys() - now)
    less = difference(now, then)
    apart = f"{less.value:+.3f} [{less.low:+.3f}, {less.high:+.3f}]" if less.count > 1 else "-"
    return [only, only_before, f"{mcnemar(only, only_before):.2f}", apart]


def main() -> None:
    """Run the cases and report."""
    cases = cases_by_name()
    parser = result_parser(__doc__, "noise_and_exploration.json")
    parser.add_argument("--runs", type=int, default=10, help="seeds (default: %(default)s)")
    parser.add_argument("--cases", nargs="+", choices=cases, default=list(cases))
    parser.add_argument("--against", type=Path, help="results of another installation")
    arguments = parser.parse_args()
    known = read_result(arguments.result)
    results: dict[str, Any] = known["cases"] if known else {}
    other = read_result(arguments.against) if arguments.against else None
    rows = []
    for name in arguments.cases:
        experiment, case = cases[name]
        found = [run(experiment, case, seed) for seed in range(1, arguments.runs + 1)]
        results[name] = {"provenance": provenance(), "title": case.title, "results": found}
        write_result(arguments.result, {"cases": results})
        before = other["cases"].get(name, {}).get("results", []) if other else []
        rows.append([name, *summary(found), *(paired(found, before) if before else [""] * 4)])
        print(*rows[-1], flush=True)
    head = ["case", "runs", "feasible", "regret, median", "mean", "kept", "CPU [s]"]
    print(table([*head, "only now", "only before", "McNemar", "regret, difference"], rows))


if __name__ == "__main__":
    main()
