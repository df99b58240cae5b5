"""A filter tuned on four drives, and what it is worth on drives that were not used.

    python benchmarks/estimators.py             10 seeds
    python benchmarks/estimators.py --seeds 3

The filter of `examples/estimators`, without ROS: a run that is played in lockstep is the same
(`tests/ros/unchanged/test_play.py`). Each seed has other drives. Beside the tuner stand the
default, Optuna's TPE on the mean error of the four drives with as many runs, and the optimum: the
parameters that are best on the mean of many drives.
"""

import statistics
import sys
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import optuna
from common import provenance, result_parser, table, write_result
from scipy.optimize import minimize
from threadpoolctl import threadpool_limits

import bo_tuner as bt
from bo_tuner.evidence.next_drive import share_shown

sys.path.append(str(Path(__file__).parents[1] / "examples/estimators"))
import robot

BOUNDS = {"speed_noise": (0.01, 3.0), "bias_walk": (1e-4, 0.3), "fix_noise": (0.05, 5.0)}
DEFAULT = {"speed_noise": 2.0, "bias_walk": 0.03, "fix_noise": 1.0}
SECONDS, TRIALS = 30.0, 25
USED, UNUSED, FRESH, MANY = 4, 29, 60, 30
"""Drives to tune on, for the certificate, for the truth, and for the optimum."""
LEAST, ASKED, CONFIDENCE = 0.85, 0.9, 0.95
ELLIPSE = 5.991
"""Squared Mahalanobis distance that 95 % of all errors in the plane are below."""


def run(parameters: dict[str, Any], seed: int) -> dict[str, float]:
    """Run the filter on the drive of a seed."""
    made = robot.drive(seed, SECONDS)
    filter_ = robot.Filter(**{name: float(parameters[name]) for name in BOUNDS})
    inside = []
    predict = filter_.predict
    truth = iter(made.truth)

    def noting(time: float, rate: float) -> None:
        predict(time, rate)
        error = next(truth)[:2] - filter_.state[:2]
        inside.append(error @ np.linalg.solve(filter_.covariance[:2, :2], error) < ELLIPSE)

    filter_.predict = noting
    found = robot.estimates(made, filter_)
    errors = np.hypot(*(found[:, 1:3] - made.truth[:, :2]).T)
    return {"error": float(np.sqrt(np.mean(errors**2))), "consistent": float(np.mean(inside))}


def study(drives: list[int]) -> bt.Study:
    """Return the study of the example, for a function."""
    names = tuple(f"drive_{seed}" for seed in drives)
    return bt.Study(
        name="filter",
        parameters={
            name: bt.Double(*bounds, default=DEFAULT[name], scale="log")
            for name, bounds in BOUNDS.items()
        },
        contexts={"drive": bt.Discrete(values=names)},
        metrics={"error": {"unit": "m"}, "consistent": {"range": (0.0, 1.0)}},
        objective="error",
        constraints={"consistency": bt.WorstCase("consistent", lower=LEAST)},
        budget=bt.Budget(trials=TRIALS, initial_trials=8, drawn_contexts=2, validation_draws=4),
        seed=drives[0],
    )


def tuned(drives: list[int]) -> tuple[dict[str, Any], int]:
    """Return what the tuner makes of some drives, and how many runs it took."""
    counted = 0

    def function(parameters: Any, context: Any, seed: int) -> dict[str, float]:
        nonlocal counted
        counted += 1
        return run(parameters, int(context["drive"].partition("_")[2]))

    result = study(drives).optimize(function, progress=False)
    return dict(result.best or DEFAULT), counted


def by_tpe(drives: list[int], runs: int) -> dict[str, float]:
    """Return the best of Optuna's TPE on the mean error, with about as many runs."""
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    search = optuna.create_study(sampler=optuna.samplers.TPESampler(seed=drives[0]))

    def objective(trial: optuna.Trial) -> float:
        chosen = {n: trial.suggest_float(n, *bounds, log=True) for n, bounds in BOUNDS.items()}
        return statistics.mean(run(chosen, seed)["error"] for seed in drives)

    search.optimize(objective, n_trials=max(runs // len(drives), 1))
    return dict(search.best_params)


def optimum() -> dict[str, float]:
    """Return the parameters that are best on the mean of many drives."""
    drives = range(900_000, 900_000 + MANY)

    def cost(logarithms: Any) -> float:
        chosen = dict(zip(BOUNDS, np.exp(logarithms), strict=True))
        return statistics.mean(run(chosen, seed)["error"] for seed in drives)

    start = np.log([robot.SPEED_NOISE, robot.BIAS_WALK, robot.FIX_NOISE])
    best = minimize(cost, start, method="Nelder-Mead", options={"maxfev": 60})
    return {name: float(value) for name, value in zip(BOUNDS, np.exp(best.x), strict=True)}


def one(seed: int, best: dict[str, float]) -> dict[str, Any]:
    """Tune on the drives of a seed, and run what came of it on others."""
    with threadpool_limits(1):
        first = 10_000 * seed
        used = list(range(first, first + USED))
        found, runs = tuned(used)
        sets = {"tuner": found, "default": DEFAULT, "tpe": by_tpe(used, runs), "optimum": best}
        fresh = range(first + 1000, first + 1000 + FRESH)
        results = {name: [run(each, other) for other in fresh] for name, each in sets.items()}
        unused = [run(found, other) for other in range(first + 100, first + 100 + UNUSED)]
    within = sum(item["consistent"] >= LEAST for item in unused)
    return {
        "parameters": sets,
        "runs": runs,
        "errors": {
            name: statistics.mean(item["error"] for item in items)
            for name, items in results.items()
        },
        "kept": {
            name: statistics.mean(item["consistent"] >= LEAST for item in items)
            for name, items in results.items()
        },
        "passed": share_shown(within, UNUSED, CONFIDENCE) >= ASKED,
    }


def main() -> None:
    """Tune and report."""
    parser = result_parser(__doc__, "estimators.json")
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--workers", type=int, default=2)
    arguments = parser.parse_args()
    best = optimum()
    with ProcessPoolExecutor(arguments.workers) as pool:
        runs = list(pool.map(one, range(1, arguments.seeds + 1), [best] * arguments.seeds))
    rows = [
        (
            name,
            f"{statistics.mean(item['errors'][name] for item in runs):.3f}",
            f"{max(item['errors'][name] for item in runs):.3f}",
            f"{100.0 * statistics.mean(item['kept'][name] for item in runs):.0f}",
        )
        for name in ("default", "tpe", "tuner", "optimum")
    ]
    print(table(("", "error [m]", "worst seed", "within the limit [%]"), rows))
    passed = [item for item in runs if item["passed"]]
    hold = sum(item["kept"]["tuner"] >= ASKED for item in passed)
    print(f"PASS: {len(passed)} of {len(runs)}; {hold} of these hold on {FRESH} fresh drives")
    result: dict[str, Any] = {"provenance": provenance(), "optimum": best, "runs": runs}
    result |= {"seconds": SECONDS, "used": USED, "unused": UNUSED, "fresh": FRESH}
    write_result(arguments.result, result | {"least": LEAST, "asked": ASKED})


if __name__ == "__main__":
    main()
