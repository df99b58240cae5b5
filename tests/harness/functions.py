"""Studies of plain functions, and a backend that evaluates them."""

import pytest

from bo_tuner.backends.protocol import SequentialBackend
from bo_tuner.metrics.collect import Collector
from bo_tuner.study.study_file import study_from_mapping
from bo_tuner.trials import (
    Evaluation,
    EvaluationState,
    Outcome,
    Stage,
    Trial,
    TrialState,
    WorstCase,
)
from bo_tuner.tuning.observer import RunObserver

NODE = {"node": "axis"}


def study_mapping(**sections):
    """A study of one node `axis`: parameter gain, context load, metrics error and peak.

    A section that is None is left out.
    """
    mapping = {
        "name": "function",
        "nodes": {"axis": NODE | {"result": "~/cut_result", "object": "axis_objects:Axis"}},
        "parameters": {"gain": NODE | {"type": "double", "bounds": [0.0, 1.0], "default": 0.5}},
        "contexts": {"load": NODE | {"distribution": "uniform", "bounds": [1.0, 2.0]}},
        "seed_parameter": NODE | {"parameter": "seed"},
        "trigger": NODE | {"service": "~/run"},
        "metrics": {"error": NODE, "peak": NODE},
        "objective": {"metric": "error"},
        "constraints": {"peak": {"kind": "worst_case", "metric": "peak", "upper": 1.0}},
        "budget": {
            "trials": 5,
            "initial_trials": 3,
            "drawn_contexts": 2,
            "search_evaluations": 2,
            "validation_draws": 5,
        },
        # The initial design alone; what comes before it is tested on its own.
        "start": [],
    } | sections
    return {key: value for key, value in mapping.items() if value is not None}


def make_study(**sections):
    """The same as a study."""
    return study_from_mapping(study_mapping(**sections))


class FunctionBackend(SequentialBackend):
    """Evaluates a function of all that the node is told; counts calls.

    The function returns the node's figures, or an Outcome.
    """

    name = "function"

    def __init__(self, study, function, sources=None):
        super().__init__(study)
        self._study = study
        self._collector = Collector(study, sources)
        self._function = function
        self.calls = []

    def open(self):
        pass

    def close(self):
        pass

    def outcome(self, planned):
        assignments = self._study.assignments(planned.parameters, planned.context, planned.seed)
        (values,) = assignments.values()
        self.calls.append(dict(values))
        said = self._function(**values)
        if isinstance(said, Outcome):
            return said
        return self._collector.outcome({"axis": {"status": "ok", "reason": ""} | said})


def failed(reason, state=EvaluationState.FAILED):
    return Outcome(state, {}, reason)


def make_trial(number, parameters, errors=(), worst=0.5, noise=0.0):
    """A trial with one drawn evaluation for each of `errors`; failed without any."""
    evaluations = [
        Evaluation(
            number, k, Stage.DRAWN, parameters, {"load": 1.5}, k,
            Outcome(EvaluationState.COMPLETE, {"error": error, "peak": worst}),
        )
        for k, error in enumerate(errors)
    ]  # fmt: skip
    if not evaluations:
        evaluations = [
            Evaluation(
                number, 0, Stage.DRAWN, parameters, {"load": 1.5}, 0, failed("axis: stalled")
            )
        ]
        return Trial(number, parameters, "", TrialState.FAILED, "axis: stalled", tuple(evaluations))
    worst_cases = {"peak": WorstCase(worst, {"load": 1.5}, worst, noise)}
    return Trial(
        number,
        parameters,
        "",
        TrialState.COMPLETE,
        evaluations=tuple(evaluations),
        worst_cases=worst_cases,
    )


@pytest.fixture(scope="session", name="make_trial")
def _make_trial():
    return make_trial


@pytest.fixture(scope="session", name="make_study")
def _make_study():
    return make_study


@pytest.fixture(scope="session", name="function_backend")
def _function_backend():
    return FunctionBackend


@pytest.fixture(scope="session", name="failed")
def _failed():
    return failed


def planned(parameters, context=None, seed=1, stage=Stage.DRAWN):
    """An evaluation that was not run yet."""
    return Evaluation(0, 0, stage, parameters, {} if context is None else context, seed)


class Watcher(RunObserver):
    """Keeps what it is told of."""

    def __init__(self):
        self.evaluations = []
        self.steps = []
        self.events = []

    def event(self, event):
        self.events.append(event)

    def evaluation(self, evaluation):
        self.evaluations.append(evaluation)

    def advance(self):
        self.steps.append(len(self.evaluations))
