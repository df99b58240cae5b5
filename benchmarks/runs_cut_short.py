"""Run time that `budget.cut_short` saves in tuning, and what the answers are worth, by the truth.

Two systems in simulated time: the motor of examples/unchanged_system under its PID, as the closed
model of wide_ranges.py, and the shipped feed axis in process. Each is tuned with the same seeds
with whole runs and with runs that are cut short. The study of the motor aborts a run beyond 2 rad,
which takes the time until then in both.

The truth of the motor is that of wide_ranges.py. That of an answer of the axis is the mean error in
drawn contexts, and the least share of runs within the overshoot limit among the corners of the
contexts.
"""

import dataclasses
import os
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

# Before the libraries that read it.
os.environ.update(OPENBLAS_NUM_THREADS="1")

import numpy as np
import wide_ranges
from common import opened, provenance, result_parser, table, write_result

from bo_tuner.backends.inprocess import InProcessBackend
from bo_tuner.backends.protocol import SequentialBackend
from bo_tuner.method_names import DEFAULT_METHOD
from bo_tuner.methods.registry import METHODS
from bo_tuner.study.metrics import ReportedMetric
from bo_tuner.study.study import Study
from bo_tuner.study.study_file import load_study
from bo_tuner.trials import (
    Evaluation,
    EvaluationState,
    Outcome,
    Stage,
    TrialState,
    Value,
)
from bo_tuner.tuning.driver import Driver
from bo_tuner.tuning.loop import Tuning
from bo_tuner.tuning.summary import choose_answer

GROWING = {"error", "overshoot", "effort", "tracking_error"}
CUT = 5.4
"""Time of a whole cut of the axis [s]."""
DRAWS, REPEATS = 40, 25
"""Runs behind the truth of an answer of the axis: in drawn contexts, and in each corner."""


class Timed(SequentialBackend):
    """Runs evaluations one after the other; `seconds` is the simulated time of all runs [s]."""

    name = "model"
    seconds = 0.0

    def open(self) -> None:
        """Nothing is needed."""

    def close(self) -> None:
        """Nothing was taken."""


class Motor(Timed):
    """Runs the closed model of the motor."""

    def outcome(self, planned: Evaluation) -> Outcome:
        """Turn the motor until its outcome is decided."""
        inertia = np.array([planned.context["inertia"]], dtype=float)
        steps = round(wide_ranges.DURATION / wide_ranges.PERIOD)
        so_far: dict[str, float] = {}
        for step, metrics in enumerate(
            wide_ranges.moving(planned.parameters, inertia, planned.seed), start=1
        ):
            self.seconds += wide_ranges.PERIOD
            so_far = {name: float(values[0]) for name, values in metrics.items()}
            if so_far["overshoot"] > 100.0:
                return Outcome(EvaluationState.FAILED, {}, "the angle is beyond 2 rad")
            beyond = [name for name, most in planned.beyond.items() if so_far[name] > most]
            if beyond and step < steps:
                return Outcome.cut_short(step * wide_ranges.PERIOD, so_far, beyond[0])
        return Outcome(EvaluationState.COMPLETE, so_far)


class Axis(Timed):
    """Runs the objects of the shipped study."""

    def __init__(self, study: Study) -> None:
        super().__init__(study)
        self._objects = InProcessBackend(study)

    def open(self) -> None:
        """Make the objects."""
        self._objects.open()

    def close(self) -> None:
        """Forget them."""
        self._objects.close()

    def outcome(self, planned: Evaluation) -> Outcome:
        """Run a cut."""
        outcome = self._objects.outcome(planned)
        self.seconds += CUT if outcome.notes.cut_after is None else outcome.notes.cut_after
        return outcome


@dataclass(frozen=True)
class System:
    """A study, what runs it, and the truth of an answer: objective, and whether it is feasible."""

    study: Study
    backend: Callable[[Study], Timed]
    truth: Callable[[Mapping[str, Value]], tuple[float, bool]]


def truth_of_motor(parameters: Mapping[str, Value]) -> tuple[float, bool]:
    """Return the mean error of a parameter set, and whether enough runs are within limits."""
    error, kept = wide_ranges.truth(parameters)
    return error, kept >= wide_ranges.PROBABILITY - wide_ranges.TOLERANCE


def truth_of_axis(study: Study) -> Callable[[Mapping[str, Value]], tuple[float, bool]]:
    """Return a function that runs a parameter set in many contexts."""
    contexts = study.context_space()
    drawn = contexts.draw_stratified(DRAWS, np.random.default_rng(0))
    corners = contexts.to_contexts(contexts.corners())
    limit = study.constraints["overshoot"]

    def truth(parameters: Mapping[str, Value]) -> tuple[float, bool]:
        with opened(InProcessBackend(study)) as backend:

            def metrics(row: np.ndarray, seed: int) -> Mapping[str, float]:
                context = contexts.to_dict(row)
                planned = Evaluation(0, 0, Stage.VALIDATION, parameters, context, seed)
                return backend.outcome(planned).metrics

            error = np.mean([metrics(row, k)["tracking_error"] for k, row in enumerate(drawn)])
            kept = [
                np.mean([metrics(row, k)["overshoot"] <= limit.limit for k in range(REPEATS)])
                for row in corners
            ]
        # Within a standard error of the share.
        return float(error), bool(min(kept) >= (limit.probability or 0.0) - 0.07)

    return truth


def with_cuts(study: Study, *, cut_short: bool) -> Study:
    """Return a study whose metrics say that they grow, with whole runs or such that are cut."""
    metrics = {
        name: dataclasses.replace(metric, grows=name in GROWING)
        for name, metric in study.metrics.items()
        if isinstance(metric, ReportedMetric)
    }
    budget = dataclasses.replace(study.budget, cut_short=cut_short)
    return dataclasses.replace(study, metrics=metrics, budget=budget)


def systems() -> dict[str, System]:
    """Return the systems by name."""
    motor = wide_ranges.study_of(wide_ranges.BOUNDS, wide_ranges.SCALES)
    axis = load_study("benchmark")
    budget = dataclasses.replace(
        axis.budget, evaluations=80, drawn_contexts=None, search_evaluations=None
    )
    return {
        "motor": System(motor, Motor, truth_of_motor),
        "axis": System(dataclasses.replace(axis, budget=budget), Axis, truth_of_axis(axis)),
    }


def run(system: System, seed: int, *, cut_short: bool) -> dict[str, Any]:
    """Tune with one seed and judge the answer."""
    begin = time.process_time()
    study = dataclasses.replace(with_cuts(system.study, cut_short=cut_short), seed=seed)
    method = METHODS[DEFAULT_METHOD]
    with opened(system.backend(study)) as backend:
        driver = Driver(backend)
        trials = list(Tuning(study, driver, method))
        tuning = backend.seconds
        answer = choose_answer(study, driver, method, trials)
        in_all = backend.seconds
    found: dict[str, Any] = {
        "seed": seed,
        "evaluations": sum(len(trial.evaluations) for trial in trials),
        "tuning": round(tuning, 2),
        "in_all": round(in_all, 2),
        "cut_short": sum(trial.state is TrialState.CUT_SHORT for trial in trials),
        "trials": len(trials),
        "feasible": False,
        "cpu": round(time.process_time() - begin, 1),
    }
    if answer is not None:
        parameters = dict(answer.candidate.trial.parameters)
        objective, feasible = system.truth(parameters)
        found |= {"parameters": parameters, "objective": objective, "feasible": feasible}
    return found


def row(name: str, found: Sequence[Mapping[str, Any]], whole: Sequence[Mapping[str, Any]]) -> list:
    """Return time, counts and the median objective of feasible answers as cells of the table."""
    objectives = [r["objective"] for r in found if r["feasible"]]
    seconds = {key: np.mean([r[key] for r in found]) for key in ("tuning", "in_all")}
    saved = {
        key: f"{100.0 * (1.0 - value / np.mean([r[key] for r in whole])):.0f} %"
        for key, value in seconds.items()
    }
    return [
        name,
        len(found),
        f"{np.sum([r['cut_short'] for r in found]) / np.sum([r['trials'] for r in found]):.2f}",
        f"{seconds['tuning']:.1f}",
        saved["tuning"],
        f"{seconds['in_all']:.1f}",
        saved["in_all"],
        len(objectives),
        f"{np.median(objectives):.4f}" if objectives else "-",
        f"{np.mean(objectives):.4f}" if objectives else "-",
    ]


def main() -> None:
    """Tune with whole runs and with runs that are cut short, and report."""
    parser = result_parser(__doc__, "runs_cut_short.json")
    parser.add_argument("--runs", type=int, default=20, help="seeds (default: %(default)s)")
    parser.add_argument("--only", choices=["motor", "axis"], help="one of the systems")
    arguments = parser.parse_args()
    known = provenance()
    results: dict[str, dict[str, list[dict[str, Any]]]] = {}
    rows = []
    for name, system in systems().items():
        if arguments.only not in (None, name):
            continue
        seeds = range(1, arguments.runs + 1)
        results[name] = {
            kind: [run(system, seed, cut_short=cut_short) for seed in seeds]
            for kind, cut_short in (("whole", False), ("cut short", True))
        }
        whole = results[name]["whole"]
        rows += [row(f"{name}, {kind}", found, whole) for kind, found in results[name].items()]
    head = ["system, runs", "seeds", "trials cut short", "tuning [s]", "saved"]
    head += ["with answer [s]", "saved", "feasible", "objective, median", "mean"]
    print(table(head, rows))
    write_result(arguments.result, {"provenance": known, "systems": results})


if __name__ == "__main__":
    main()
