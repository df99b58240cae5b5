"""How often a trial breaks a limit, in a safe search and in a plain one.

Both start from the same parameter set, which keeps all limits and is far from the best. A trial
counts as one that breaks a limit if any of its runs does, or fails. The other question is what that
costs: the runs until the best parameter set whose runs have all kept the limits is as good as the
plain search's at its end, within `WITHIN`.

The cases are the milling study of the benchmark, with its nodes as objects, and the position loop
of examples/unchanged_system as a function: its equations, with noise of the encoder.
"""

import os
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

# Before the libraries that read it.
os.environ.update(OPENBLAS_NUM_THREADS="1")

import numpy as np
from common import BENCHMARKS, opened, provenance, result_parser, table, write_result

from bo_tuner.backends.function import FunctionBackend
from bo_tuner.backends.inprocess import InProcessBackend
from bo_tuner.backends.protocol import Backend
from bo_tuner.methods.registry import METHODS
from bo_tuner.study.function_study import with_function
from bo_tuner.study.limits import is_within_limits
from bo_tuner.study.study import Study
from bo_tuner.study.study_file import load_study, study_from_mapping, study_to_mapping
from bo_tuner.trials import Evaluation, Stage, Trial, Value
from bo_tuner.tuning.driver import Driver
from bo_tuner.tuning.loop import Tuning

SEARCHES = {"plain": "boundary", "safe": "safe"}
"""Method of each search."""
TRIALS = 20
"""Of a plain search; a safe one may have twice as many."""
WITHIN = 0.05
"""By how much, relative to it, an objective may be worse than another and count as good as it."""
JUDGED = 12
"""Runs by which the objective of a parameter set is judged."""
EXAMPLE = BENCHMARKS.parent / "examples" / "unchanged_system" / "study.yaml"

INERTIA, FRICTION, MAX_TORQUE, LAG = 0.02, 0.05, 1.0, 0.02
PERIOD, STEPS, DURATION = 0.01, 20, 2.0
ENCODER = 2e-4
"""Standard deviation of the angle as it is measured [rad]."""


def turn(parameters: Mapping[str, Value], _: Mapping[str, Value], seed: int) -> dict[str, float]:
    """Turn the motor of the example by 1 rad under its controller, from rest."""
    kp, ki, kd = (float(parameters[name]) for name in ("kp", "ki", "kd"))
    noise = np.random.default_rng(seed).normal(0.0, ENCODER, round(DURATION / PERIOD))
    angle = speed = torque = integral = last = 0.0
    angles, torques, h = [], [], PERIOD / STEPS
    for disturbance in noise:
        measured = angle + disturbance
        error = 1.0 - measured
        rate = speed + disturbance / PERIOD - last / PERIOD
        last = disturbance
        wanted = kp * error + integral - kd * rate
        if abs(wanted) < MAX_TORQUE:
            integral += ki * PERIOD * error
        wanted = min(max(wanted, -MAX_TORQUE), MAX_TORQUE)
        for _ in range(STEPS):
            torque += h / LAG * (wanted - torque)
            speed += h / INERTIA * (torque - FRICTION * speed)
            angle += h * speed
        angles.append(angle)
        torques.append(wanted)
    return {
        "error": PERIOD * float(np.sum(np.abs(1.0 - np.array(angles)))),
        "overshoot": 100.0 * max(max(angles) - 1.0, 0.0),
        "effort": float(np.sum(np.abs(np.diff([0.0, *torques])))),
    }


def milling() -> Study:
    """Return the milling study, from a cautious weight on input moves."""
    study = load_study("benchmark")
    return replace(study, start=({"control_horizon": 8, "lambda_mpc": 0.0},))


def position() -> Study:
    """Return the study of the example as one of a function, from a slow controller."""
    mapping = study_to_mapping(load_study(EXAMPLE))
    kept = ("name", "parameters", "objective", "constraints", "budget", "seed")
    given: dict[str, Any] = {key: mapping[key] for key in kept if key in mapping}
    for parameter in given["parameters"].values():
        del parameter["node"]
    metrics = {name: {"unit": unit} for name, unit in UNITS.items()}
    start = [{"kp": 0.3, "ki": 0.0, "kd": 0.1}]
    return study_from_mapping(with_function({**given, "metrics": metrics, "start": start}))


UNITS = {"error": "rad s", "overshoot": "%", "effort": "N m"}


@dataclass(frozen=True)
class Case:
    """A study, and what runs it."""

    study: Callable[[], Study]
    backend: Callable[[Study], Backend]


CASES = {
    "milling": Case(milling, InProcessBackend),
    "position": Case(position, lambda study: FunctionBackend(study, turn)),
}


def run(case_name: str, search: str, seed: int) -> dict[str, Any]:
    """Search with one seed, and return what each trial came to."""
    case = CASES[case_name]
    trials = TRIALS if search == "plain" else 2 * TRIALS
    study = case.study()
    study = replace(study, seed=seed, budget=replace(study.budget, trials=trials, evaluations=None))
    with opened(case.backend(study)) as backend:
        tuning = Tuning(study, Driver(backend), METHODS[SEARCHES[search]])
        for _ in tuning:
            pass
        best = best_so_far(study, backend, tuning.trials)
    within = [is_within_limits(study, trial) for trial in tuning.trials]
    return {
        "seed": seed,
        "trials": len(within),
        "broken": sum(not each for each in within),
        "runs": [len(trial.evaluations) for trial in tuning.trials],
        "best": best,
        "standstill": tuning.plan.standstill,
    }


def best_so_far(study: Study, backend: Backend, trials: Sequence[Trial]) -> list[float]:
    """Return the least objective after each trial, by `JUDGED` runs that are the same for all.

    A parameter set counts if these, too, keep all limits.
    """
    contexts = study.context_space()
    drawn = contexts.draw_stratified(JUDGED, np.random.default_rng(0))
    objectives = []
    for trial in trials:
        planned = [
            Evaluation(0, k, Stage.VALIDATION, trial.parameters, contexts.to_dict(row), 10_000 + k)
            for k, row in enumerate(drawn)
        ]
        judged = replace(trial, evaluations=tuple(backend.run(iter(planned))))
        kept = is_within_limits(study, trial) and is_within_limits(study, judged)
        values = [e.outcome.metrics[study.objective.metric] for e in judged.evaluations if kept]
        objectives.append(float(np.mean(values)) if kept else np.inf)
    return np.minimum.accumulate(objectives).tolist()


def runs_to(result: Mapping[str, Any], objective: float) -> int | None:
    """Return after how many runs a search was as good as an objective; None if it never was."""
    reached = np.flatnonzero(np.array(result["best"]) <= (1.0 + WITHIN) * objective)
    return int(np.cumsum(result["runs"])[reached[0]]) if len(reached) else None


def compared(
    plain: Sequence[Mapping[str, Any]], safe: Sequence[Mapping[str, Any]]
) -> dict[str, Any]:
    """Return the shares of trials that break a limit, and the runs to the same objective."""
    pairs = []
    for one, other in zip(plain, safe, strict=True):
        target = one["best"][-1]
        pairs.append((runs_to(one, target), runs_to(other, target)))
    ratios = [safe_runs / runs for runs, safe_runs in pairs if runs and safe_runs]
    return {
        **{
            search: {key: sum(r[key] for r in results) for key in ("trials", "broken")}
            for search, results in (("plain", plain), ("safe", safe))
        },
        "runs": pairs,
        "reached": len(ratios),
        "ratio": float(np.median(ratios)) if ratios else None,
    }


def main() -> None:
    """Run all cases and report."""
    parser = result_parser(__doc__, "safe_search.json")
    parser.add_argument("--runs", type=int, default=10, help="seeds (default: %(default)s)")
    parser.add_argument("--jobs", type=int, default=1, help="processes (default: %(default)s)")
    parser.add_argument("--cases", nargs="+", choices=CASES, default=list(CASES))
    arguments = parser.parse_args()
    result: dict[str, Any] = {"provenance": provenance(), "cases": {}}
    rows = []
    with ProcessPoolExecutor(arguments.jobs) as pool:
        for case in arguments.cases:
            pending = {
                search: [pool.submit(run, case, search, k + 1) for k in range(arguments.runs)]
                for search in SEARCHES
            }
            each = {search: [item.result() for item in items] for search, items in pending.items()}
            summary = compared(each["plain"], each["safe"])
            result["cases"][case] = {**each, "summary": summary}
            shares = [
                f"{summary[search]['broken']} of {summary[search]['trials']}" for search in SEARCHES
            ]
            reached = f"{summary['reached']} of {arguments.runs}"
            rows.append([case, *shares, reached, summary["ratio"]])
            print(f"{case}: {summary}", flush=True)
            write_result(Path(arguments.result), result)
    columns = ["case", "plain breaks a limit", "safe", "reaches plain's objective", "runs, ratio"]
    print(table(columns, rows))


if __name__ == "__main__":
    main()
