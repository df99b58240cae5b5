"""What a window of several trials costs in quality: answers of `boundary` at equally many runs.

With a window of q, a trial is proposed without the results of the q - 1 before it. Each window has
the seeds of the others, and is compared with that of one: the seeds with a truly feasible answer in
only one of both, and the difference of the regret where both have one, as the ablations do.
"""

import os
from typing import Any

# Before the libraries that read it.
os.environ.update(OPENBLAS_NUM_THREADS="1")

from ablations import SHIPPED, VARIANTS, compare, judged
from common import provenance, result_parser, table, write_result

from tuning_benchmark.experiments.experiment_file import load_experiment
from tuning_benchmark.pages.statistics import share

CASES = {"mean": "boundary", "closed-2-1": "closed_form", "closed-4-2": "closed_form"}
"""Experiment of each case."""

WINDOWS = (1, 4, 8)


def main() -> None:
    """Run all windows on all cases and report."""
    parser = result_parser(__doc__, "windows.json")
    parser.add_argument("--runs", type=int, default=20, help="seeds (default: %(default)s)")
    arguments = parser.parse_args()
    seeds = range(1, arguments.runs + 1)
    result: dict[str, Any] = {"provenance": provenance() | {"seeds": list(seeds)}, "cases": {}}
    shipped = next(variant for variant in VARIANTS if variant.title == SHIPPED)
    rows = []
    for name, source in CASES.items():
        experiment = load_experiment(source)
        case = experiment.cases[name]
        optimum = experiment.optimum(case.study)
        if optimum is None:
            raise SystemExit(f"error: {name}: no optimum is known")
        windows: dict[str, Any] = {}
        result["cases"][name] = {"title": case.title, "windows": windows}
        for window in WINDOWS:
            found = [judged(experiment, name, shipped, seed, window) for seed in seeds]
            for run in found:
                if run["feasible"]:
                    # In place of the objective, for `compare`: cases have their own scales.
                    run["objective"] = run["objective"] / optimum.objective - 1.0
            one = windows["1"]["results"] if windows else found
            compared = compare(found, one)
            counted = share(compared["feasible"], arguments.runs)
            compared |= {"interval": [counted.low, counted.high]}
            windows[str(window)] = {"results": found} | compared
            rows.append([name, window, compared["feasible"], compared["objective"]])
            write_result(arguments.result, result)
            print(name, window, compared, flush=True)
    print(table(["case", "window", "feasible", "regret"], rows))


if __name__ == "__main__":
    main()
