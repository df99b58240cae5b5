"""What the trials gain that the advice to stop would have spared.

    python benchmarks/stop_advice.py

Each run optimizes a robust problem with a known optimum (`tuning_benchmark.problems.closed_form`)
up to its budget. Where the advice to stop is given, the answer is also settled from the trials up
to then, as `tune --stop-early` does. The realized gain is the difference of the true expected costs
of both answers; beside it stands the gain that the advice expected of the models. The result goes
to benchmarks/results/stop_advice.json, from which results_page.py writes a section of
docs/performance.md.
"""

from collections.abc import Sequence
from dataclasses import asdict, replace
from typing import Any

import numpy as np
from common import opened, provenance, result_parser, table, write_result
from threadpoolctl import threadpool_limits

from bo_tuner.backends.inprocess import InProcessBackend
from bo_tuner.methods.protocol import Method
from bo_tuner.methods.registry import METHODS
from bo_tuner.methods.stopping import StopAdvisor
from bo_tuner.study.study import Study
from bo_tuner.trials import Trial
from bo_tuner.tuning.driver import Driver
from bo_tuner.tuning.loop import Tuning
from bo_tuner.tuning.summary import choose_answer
from tuning_benchmark.problems.closed_form import CONSTANT, LIMIT, ClosedForm

PROBLEM = ClosedForm(parameters=2, contexts=1, noise=CONSTANT)
TRIALS = 40


def answer(study: Study, method: Method, trials: Sequence[Trial]) -> dict[str, Any] | None:
    """Settle the answer from trials, and return its true cost and worst mean; None without one."""
    with opened(InProcessBackend(study)) as backend:
        found = choose_answer(study, Driver(backend), method, trials)
    if found is None:
        return None
    point = PROBLEM.point(found.candidate.trial.parameters)
    worst, _ = PROBLEM.worst(point)
    return {
        "trial": found.candidate.trial.number,
        "shown_feasible": found.candidate.believed_feasible,
        "cost": float(PROBLEM.cost(point)),
        "worst": worst,
    }


def run(name: str, seed: int) -> dict[str, Any]:
    """Optimize once, and compare the answers with and without the advice."""
    study, method = PROBLEM.study(), METHODS[name]
    study = replace(study, seed=seed, budget=replace(study.budget, trials=TRIALS))
    advisor = StopAdvisor(study, method)
    with opened(InProcessBackend(study)) as backend:
        tuning = Tuning(study, Driver(backend), method)
        for _ in tuning:
            advisor.consider(tuning.trials)
    whole = answer(study, method, tuning.trials)
    result: dict[str, Any] = {"seed": seed, "algorithm": name, "whole": whole, "advice": None}
    if advisor.advice is not None:
        stopped = answer(study, method, tuning.trials[: advisor.advice.trials])
        result |= {"advice": asdict(advisor.advice), "stopped": stopped}
        result["gain"] = None if None in (whole, stopped) else stopped["cost"] - whole["cost"]
    return result


def summarize(runs: list[dict[str, Any]]) -> dict[str, Any]:
    """Compare expected and realized gains over the runs with an advice."""
    advised = [r for r in runs if r.get("gain") is not None]
    summary: dict[str, Any] = {"runs": len(runs), "advised": len(advised)}
    if not advised:
        return summary
    gains = np.array([r["gain"] for r in advised])
    expected = np.array([r["advice"]["expected_gain"] for r in advised])
    noise = np.array([r["advice"]["noise"] for r in advised])
    return summary | {
        "trials": float(np.median([r["advice"]["trials"] for r in advised])),
        "expected": float(np.median(expected)),
        "realized": float(np.median(gains)),
        "largest_realized": float(gains.max()),
        "noise": float(np.median(noise)),
        "within_expected": int((gains <= expected).sum()),
        "within_noise": int((gains <= noise).sum()),
        "feasible_stopped": sum(r["stopped"]["worst"] <= LIMIT for r in advised),
        "feasible_whole": sum(r["whole"]["worst"] <= LIMIT for r in advised),
    }


def main() -> None:
    """Measure and report."""
    parser = result_parser(__doc__, "stop_advice.json")
    parser.add_argument("--seeds", type=int, default=20, help="(default: %(default)s)")
    parser.add_argument("--first", type=int, default=1, help="first seed (default: %(default)s)")
    parser.add_argument("--algorithms", nargs="+", default=["boundary"], choices=list(METHODS))
    arguments = parser.parse_args()
    seeds = list(range(arguments.first, arguments.first + arguments.seeds))
    about = provenance() | {"seeds": seeds}
    runs = []
    with threadpool_limits(1):
        for name in arguments.algorithms:
            for seed in seeds:
                runs.append(run(name, seed))
                print(runs[-1], flush=True)
    found = {
        name: summarize([r for r in runs if r["algorithm"] == name])
        for name in arguments.algorithms
    }
    best = {"problem": PROBLEM.name, "trials": TRIALS, "optimum": PROBLEM.best}
    write_result(arguments.result, {"provenance": about} | best | {"summary": found, "runs": runs})
    for name, summary in found.items():
        print(table([name, ""], [[key, value] for key, value in summary.items()]), "\n")


if __name__ == "__main__":
    main()
