"""Runs of a backend, one after the other."""

from functions import FunctionBackend, planned

from bo_tuner.backends import protocol
from bo_tuner.trials import EvaluationState, Outcome


def test_the_time_of_an_evaluation_is_without_that_of_the_runs_that_warmed_up(
    make_study, monkeypatch
):
    times = iter([10.0, 17.5])
    monkeypatch.setattr(protocol, "monotonic", lambda: next(times))
    warmed = Outcome(EvaluationState.COMPLETE).noted(warm_ups=1, warm_up_seconds=3.0)
    backend = FunctionBackend(make_study(), lambda **_: warmed)
    (evaluation,) = backend.run([planned({"gain": 0.5}, {"load": 1.5})])
    assert evaluation.seconds == 4.5
    assert evaluation.outcome == warmed
