"""Answers in few trials where parameters have the wide ranges that nodes declare, by the truth.

The system is a closed model of examples/unchanged_system: its motor, whose inertia is the context,
under its PID, both with measurement noise. The ranges are those of a node that permits much more
than is of use, on the scales that `init` proposes; the budget is that of `init`, too. The default
breaks its limits, as a first guess does.

*Narrowed* is the same study with bounds of a fifth of the width around the best parameter set, on
the scale of the parameter. The truth of a parameter set is that of `TRUTH` runs over the contexts,
the same for all of them, and the best one is found by differential evolution of the truth.
"""

import os
import time
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

# Before the libraries that read it.
os.environ.update(OPENBLAS_NUM_THREADS="1")

import numpy as np
from common import provenance, result_parser, table, write_result
from scipy.optimize import differential_evolution

import bo_tuner as bt
from bo_tuner.backends.function import FunctionBackend
from bo_tuner.method_names import DEFAULT_METHOD
from bo_tuner.methods.protocol import Method
from bo_tuner.methods.registry import METHODS
from bo_tuner.numerics.arrays import Array
from bo_tuner.study.study import Study
from bo_tuner.trials import TrialState, count_evaluations
from bo_tuner.tuning.driver import Driver
from bo_tuner.tuning.loop import Tuning
from bo_tuner.tuning.summary import choose_answer

TITLE = "Three gains with wide ranges, 20 trials"

PERIOD, DURATION, SUBSTEPS = 0.01, 2.0, 20  # [s]
INERTIA, FRICTION, MAX_TORQUE, LAG = 0.02, 0.05, 1.0, 0.02
NOISE = 0.001, 0.01
"""Standard deviations of the measured angle [rad] and speed [rad/s]."""

OVERSHOOT, EFFORT, PROBABILITY = 5.0, 8.0, 0.9
TRUTH = 400
TOLERANCE = 0.02
"""Shortfall of the share within limits that still counts as feasible: a standard error of it."""

BOUNDS: Mapping[str, tuple[float, float]] = {
    "kp": (0.5, 100.0),
    "ki": (0.0, 100.0),
    "kd": (0.0, 10.0),
}
DEFAULTS = {"kp": 0.5, "ki": 0.0, "kd": 0.02}
SCALES = {"kp": "log", "ki": "symlog", "kd": "symlog"}


def moves(parameters: Mapping[str, Any], inertia: Array, seed: int) -> dict[str, Array]:
    """Turn the motor by 1 rad, with each inertia (m,) of its nominal one; returns metrics (m,)."""
    *_, metrics = moving(parameters, inertia, seed)
    return metrics


def moving(parameters: Mapping[str, Any], inertia: Array, seed: int) -> Iterator[dict[str, Array]]:
    """Turn the motor as `moves` does; yields the metrics (m,) so far after each step."""
    rng = np.random.default_rng(seed)
    kp, ki, kd = (float(parameters[name]) for name in BOUNDS)
    steps = round(DURATION / PERIOD)
    transition = np.linalg.matrix_power(_one_step(inertia), SUBSTEPS)
    state, integral = np.zeros((len(inertia), 4)), np.zeros(len(inertia))
    error, highest, effort = np.zeros((3, len(inertia)))
    noise = rng.normal(size=(steps, 2, len(inertia))) * np.array(NOISE)[:, None]
    for of_angle, of_speed in noise:
        off = 1.0 - (state[:, 2] + of_angle)
        asked = kp * off + integral - kd * (state[:, 1] + of_speed)
        integral = np.where(np.abs(asked) < MAX_TORQUE, integral + ki * PERIOD * off, integral)
        command = np.clip(asked, -MAX_TORQUE, MAX_TORQUE)
        effort += np.abs(command - state[:, 3])
        state[:, 3] = command
        state = np.einsum("mij,mj->mi", transition, state)
        error += PERIOD * np.abs(1.0 - state[:, 2])
        highest = np.maximum(highest, state[:, 2])
        yield {
            "error": error,
            "overshoot": 100.0 * np.maximum(highest - 1.0, 0.0),
            "effort": effort,
        }


def _one_step(inertia: Array) -> Array:
    """Return what a step of the motor node does to torque, speed, angle and command, (m, 4, 4)."""
    step, torque, speed, angle = PERIOD / SUBSTEPS, *np.tile(np.eye(4), (3, len(inertia), 1, 1))
    torque[:, 0] += step / LAG * np.array([-1.0, 0.0, 0.0, 1.0])
    speed[:, 1, 0] = step / (INERTIA * inertia)
    speed[:, 1, 1] -= step * FRICTION / (INERTIA * inertia)
    angle[:, 2, 1] = step
    return angle @ speed @ torque


def one_move(
    parameters: Mapping[str, Any], context: Mapping[str, Any], seed: int
) -> dict[str, float]:
    """Return the metrics of one move, as a function that is tuned does."""
    metrics = moves(parameters, np.array([context["inertia"]]), seed)
    if metrics["overshoot"][0] > 100.0:
        raise bt.Failed("the angle is beyond 2 rad")
    return {name: float(values[0]) for name, values in metrics.items()}


def study_of(bounds: Mapping[str, tuple[float, float]], scales: Mapping[str, str]) -> Study:
    """Return the study with these bounds; the default is the nearest value to the node's."""
    parameters = {
        name: {
            "type": "double",
            "bounds": list(bounds[name]),
            "default": float(np.clip(DEFAULTS[name], *bounds[name])),
            "scale": scales[name],
        }
        for name in bounds
    }
    limits = {"overshoot": OVERSHOOT, "effort": EFFORT}
    return bt.Study(
        name="wide_ranges",
        parameters=parameters,
        contexts={"inertia": bt.Uniform(bounds=(0.7, 1.5))},
        metrics=["error", *limits],
        objective={"metric": "error"},
        constraints={
            name: {"kind": "chance", "metric": name, "upper": upper, "probability": PROBABILITY}
            for name, upper in limits.items()
        },
        budget={"trials": 20, "initial_trials": 8, "drawn_contexts": 1, "validation_draws": 5},
    ).checked


INERTIAS = 0.7 + 0.8 * (np.arange(TRUTH) + 0.5) / TRUTH


def truth(parameters: Mapping[str, Any]) -> tuple[float, float]:
    """Return the mean error of a parameter set, and the least share of runs within a limit."""
    found = moves(parameters, INERTIAS, 0)
    kept = min((found["overshoot"] <= OVERSHOOT).mean(), (found["effort"] <= EFFORT).mean())
    return float(found["error"].mean()), float(kept)


def best(study: Study) -> dict[str, float]:
    """Return the best parameter set of a study; a minute and more."""
    space = study.search_space()

    def penalized(u: Array) -> float:
        error, kept = truth(space.to_parameters(u))
        return error + 10.0 * max(PROBABILITY - kept, 0.0)

    found = differential_evolution(penalized, [(0.0, 1.0)] * space.dimension, rng=1, maxiter=60)
    return {name: float(value) for name, value in space.to_parameters(found.x).items()}


def narrowed(study: Study, optimum: Mapping[str, float]) -> dict[str, tuple[float, float]]:
    """Return bounds of a fifth of the width around the optimum, on the scales of the study."""
    space = study.search_space()
    u = space.to_cube(optimum)
    low = np.clip(u - 0.1, 0.0, 0.8)
    lower, upper = (space.to_parameters(edge) for edge in (low, low + 0.2))
    return {name: (float(lower[name]), float(upper[name])) for name in space.names}


def wide_study() -> Study:
    """Return the study with all of the ranges."""
    return study_of(BOUNDS, SCALES)


def run(study: Study, seed: int, method: Method = METHODS[DEFAULT_METHOD]) -> dict[str, Any]:
    """Tune with one seed and judge the answer."""
    begin = time.process_time()
    study = study.replace(seed=seed)
    driver = Driver(FunctionBackend(study, one_move))
    tuning = Tuning(study, driver, method)
    trials = list(tuning)
    answer = choose_answer(study, driver, method, trials)
    found: dict[str, Any] = {
        "seed": seed,
        "evaluations": count_evaluations(trials),
        "failed": sum(trial.state is TrialState.FAILED for trial in trials),
        "feasible": False,
        "seconds": round(time.process_time() - begin, 1),
    }
    if answer is not None:
        parameters = dict(answer.candidate.trial.parameters)
        error, kept = truth(parameters)
        found |= {
            "parameters": parameters,
            "objective": error,
            "kept": kept,
            "believed": answer.feasible,
            "feasible": kept >= PROBABILITY - TOLERANCE,
        }
    return found


def row(name: str, found: Sequence[Mapping[str, Any]], reference: float) -> list[Any]:
    """Return counts and the median error of feasible answers as cells of the table."""
    errors = [r["objective"] for r in found if r["feasible"]]
    close = sum(error <= 1.2 * reference for error in errors)
    return [
        name,
        len(found),
        len(errors),
        f"{np.median(errors):.4f}" if errors else "-",
        close,
        f"{np.mean([r['failed'] for r in found]):.1f}",
        f"{np.mean([r['seconds'] for r in found]):.1f}",
    ]


def main() -> None:
    """Tune with wide ranges and with narrowed ones, and report."""
    parser = result_parser(__doc__, "wide_ranges.json")
    parser.add_argument("--runs", type=int, default=10, help="seeds (default: %(default)s)")
    arguments = parser.parse_args()
    wide = wide_study()
    optimum = best(wide)
    print("optimum", optimum, *truth(optimum), "default", *truth(DEFAULTS), flush=True)
    narrow = study_of(narrowed(wide, optimum), SCALES)
    results = {
        name: [run(study, seed) for seed in range(1, arguments.runs + 1)]
        for name, study in (("narrowed", narrow), ("wide", wide))
    }
    reference = min(
        (r["objective"] for r in results["narrowed"] if r["feasible"]), default=truth(optimum)[0]
    )
    write_result(
        arguments.result,
        {"provenance": provenance(), "optimum": optimum, "reference": reference} | results,
    )
    head = ["bounds", "runs", "feasible", "error, median", "within 20 %", "failed", "CPU [s]"]
    print(f"best answer with narrowed bounds: {reference:.4f}")
    print(table(head, [row(name, found, reference) for name, found in results.items()]))


if __name__ == "__main__":
    main()
