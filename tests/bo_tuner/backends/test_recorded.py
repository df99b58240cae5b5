"""Evaluations on record take the place of the same ones that are asked for."""

from dataclasses import replace

from functions import planned

from bo_tuner.backends.recorded import RecordedEvaluations
from bo_tuner.trials import Evaluation, EvaluationState, Outcome, Stage


def test_each_is_given_once_and_only_for_the_same_assignments(make_study, function_backend):
    study = make_study()
    outcomes = [Outcome(EvaluationState.COMPLETE, {"error": e, "peak": 0.1}) for e in (1.0, 2.0)]
    recorded = [
        Evaluation(0, k, Stage.DRAWN, {"gain": 0.5}, {"load": 1.5}, 7, outcome, seconds=k + 2.0)
        for k, outcome in enumerate(outcomes)
    ]
    ran = []

    def function(**values):
        ran.append(values)
        return {"error": 3.0, "peak": 0.1}

    backend = RecordedEvaluations(function_backend(study, function), study, recorded)
    backend.open()
    same = planned({"gain": 0.5}, {"load": 1.5}, 7)
    given = list(backend.run([same, same]))
    assert [evaluation.outcome for evaluation in given] == outcomes
    assert all(evaluation.recorded for evaluation in given)
    assert [evaluation.seconds for evaluation in given] == [2.0, 3.0]
    assert ran == []
    (new,) = backend.run([same])
    assert new.outcome.metrics["error"] == 3.0
    assert not new.recorded
    list(backend.run([planned({"gain": 0.5}, {"load": 1.5 + 2**-50}, 7)]))
    assert len(ran) == 2


def test_without_a_parameter_for_the_seed_other_seeds_are_other_evaluations(
    make_study, function_backend
):
    """A repetition or a validation draw in a context on record is a run of its own."""
    study = make_study(seed_parameter=None)
    outcome = Outcome(EvaluationState.COMPLETE, {"error": 1.0, "peak": 0.1})
    recorded = Evaluation(0, 0, Stage.DRAWN, {"gain": 0.5}, {"load": 1.5}, 7, outcome)
    backend = RecordedEvaluations(
        function_backend(study, lambda **_: {"error": 3.0, "peak": 0.1}), study, [recorded]
    )
    backend.open()
    others = [
        planned({"gain": 0.5}, {"load": 1.5}, 8),
        replace(planned({"gain": 0.5}, {"load": 1.5}, 7), stage=Stage.VALIDATION),
    ]
    assert [e.outcome.metrics["error"] for e in backend.run(others)] == [3.0, 3.0]
    (same,) = backend.run([planned({"gain": 0.5}, {"load": 1.5}, 7)])
    assert same.outcome == outcome


def test_what_another_study_took_is_judged_by_this_one(make_study, function_backend):
    """As a run continues that had another scale."""
    study = make_study(objective={"metric": "error", "scale": "log"})
    outcome = Outcome(EvaluationState.COMPLETE, {"error": -1.0, "peak": 0.1})
    recorded = Evaluation(0, 0, Stage.DRAWN, {"gain": 0.5}, {"load": 1.5}, 7, outcome)
    backend = RecordedEvaluations(function_backend(study, lambda **_: {}), study, [recorded])
    (given,) = backend.run([planned({"gain": 0.5}, {"load": 1.5}, 7)])
    assert given.outcome.reason == "metric error is -1.0; its log scale needs a positive value"


def test_what_is_on_record_does_not_wait_for_what_is_run(make_study, function_backend):
    """Such as for a worker: those that follow from it can begin meanwhile."""
    study = make_study()
    outcome = Outcome(EvaluationState.COMPLETE, {"error": 1.0, "peak": 0.1})
    recorded = Evaluation(0, 0, Stage.DRAWN, {"gain": 0.5}, {"load": 1.5}, 7, outcome)
    inner = function_backend(study, lambda **_: {"error": 3.0, "peak": 0.1})
    backend = RecordedEvaluations(inner, study, [recorded])
    others = [planned({"gain": gain}, {"load": 1.5}, 7) for gain in (0.25, 0.5, 0.75)]
    given = backend.run(others)
    assert next(given).recorded
    assert inner.calls == []
    assert [evaluation.parameters["gain"] for evaluation in given] == [0.25, 0.75]
