"""The default beside each evaluation, in the same context and with the same seed."""

import numpy as np
import pytest
from certified import collect
from functions import FunctionBackend, failed, planned

from bo_tuner.backends.layers.beside_default import beside_default
from bo_tuner.errors import RunError
from bo_tuner.evidence.certificate.judgement import judge
from bo_tuner.methods.registry import METHODS
from bo_tuner.metrics.collect import LARGEST_METRIC
from bo_tuner.run_notes import Notes, Unusable
from bo_tuner.trials import EvaluationState, Outcome, TrialState
from bo_tuner.tuning.driver import Driver
from bo_tuner.tuning.loop import Tuning

DEFAULT = 0.5
CALM = {"kind": "chance", "metric": "peak", "upper": "1.1 * default", "probability": 0.9}


def machine(gain, load, seed):
    """Noise and context double and halve the peak: a fixed limit tells little of the gain."""
    return {"error": (gain - 1.0) ** 2, "peak": gain * load * (1.0 + seed % 7)}


@pytest.fixture
def study(make_study):
    return make_study(constraints={"calm": CALM})


def run(backend, gain, load=1.5, seed=3):
    (found,) = backend.run([planned({"gain": gain}, {"load": load}, seed)])
    return found.outcome


def test_the_difference_is_that_of_the_same_draw(study):
    backend = FunctionBackend(study, machine)
    for load, seed in ((1.0, 3), (2.0, 3), (2.0, 4)):
        found = run(backend, 0.8, load, seed)
        peak = 0.8 * load * (1.0 + seed % 7)
        default = DEFAULT * load * (1.0 + seed % 7)
        assert found.metrics["peak"] == peak
        assert found.metrics["peak_minus_1.1_default"] == peak - 1.1 * default
        assert found.notes.default == {"peak": default}
        assert list(found.metrics) == list(study.metrics)
    calls = [(call["gain"], call["load"], call["seed"]) for call in backend.calls]
    assert calls == [
        (gain, *draw) for draw in ((1.0, 3), (2.0, 3), (2.0, 4)) for gain in (DEFAULT, 0.8)
    ]


def test_the_default_is_run_once_in_a_draw(study):
    backend = FunctionBackend(study, machine)
    for gain in (0.8, 0.9, DEFAULT, 0.3):
        run(backend, gain)
    assert [call["gain"] for call in backend.calls] == [DEFAULT, 0.8, 0.9, DEFAULT, 0.3]


def test_the_default_is_its_own_pair(study):
    backend = FunctionBackend(study, machine)
    found = run(backend, DEFAULT)
    assert found.metrics["peak_minus_1.1_default"] == pytest.approx(-0.1 * found.metrics["peak"])
    run(backend, 0.8)
    assert [call["gain"] for call in backend.calls] == [DEFAULT, 0.8]


def starts(outcome):
    return outcome.notes.starts, outcome.notes.start_seconds


def test_starts_of_the_default_beside_it_count(study):
    """Where nodes start anew for each of the two; the default's of a draw is run only once."""
    backend, seconds = FunctionBackend(study, machine), iter((1.0, 0.5, 0.25))

    def alone(planned):
        return backend.outcome(planned).with_starts(1, next(seconds))

    beside = beside_default(study, lambda: None)(alone)
    assert starts(beside(planned({"gain": 0.8}, {"load": 1.5}))) == (2, 1.5)
    assert starts(beside(planned({"gain": 0.9}, {"load": 1.5}))) == (1, 0.25)


def test_without_such_a_limit_nothing_else_is_run(make_study):
    backend = FunctionBackend(make_study(), machine)
    assert list(run(backend, 0.8).metrics) == ["error", "peak"]
    assert len(backend.calls) == 1


def test_several_limits_share_one_run(make_study):
    constraints = {
        "calm": CALM,
        "brisk": CALM | {"upper": None, "lower": "0.9 * default - 0.5"},
        "good": CALM | {"metric": "error", "upper": "default + 0.125"},
    }
    constraints["brisk"] = {k: v for k, v in constraints["brisk"].items() if v is not None}
    backend = FunctionBackend(make_study(constraints=constraints), machine)
    found = run(backend, 0.25, 1.0, 0).metrics
    assert found["peak_minus_1.1_default"] == pytest.approx(0.25 - 0.55)
    assert found["peak_minus_0.9_default"] == pytest.approx(0.25 - 0.45)
    assert found["error_minus_default"] == 0.75**2 - 0.5**2
    assert len(backend.calls) == 2


def test_of_a_combined_metric(make_study):
    metrics = {
        "cost": {"expression": "error + 2 * peak"},
        "error": {"node": "axis"},
        "peak": {"node": "axis"},
    }
    made = make_study(metrics=metrics, constraints={"calm": CALM | {"metric": "cost"}})
    found = run(FunctionBackend(made, machine), 0.25, 1.0, 0).metrics
    assert found["cost_minus_1.1_default"] == pytest.approx(0.5625 + 0.5 - 1.1 * (0.25 + 1.0))


def test_that_the_default_is_done_is_told_before_the_evaluation_begins(study):
    backend = FunctionBackend(study, machine)
    done = []
    backend.after_extra_run = lambda: done.append(len(backend.calls))
    for gain in (0.8, 0.9, DEFAULT):
        run(backend, gain)
    assert done == [1]


@pytest.mark.parametrize(
    ("ended", "state", "ending"),
    [
        (failed("diverged"), EvaluationState.FAILED, Unusable.UNPREPARED),
        (failed("gone", EvaluationState.LOST), EvaluationState.LOST, "lost"),
        (
            Outcome(EvaluationState.FAILED, reason="touched", notes=Notes(Unusable.DISTURBED)),
            EvaluationState.FAILED,
            Unusable.DISTURBED,
        ),
    ],
)
def test_where_the_default_fails_nothing_is_known_of_the_parameters(study, ended, state, ending):
    backend = FunctionBackend(
        study, lambda gain, **draw: ended if gain == DEFAULT else machine(gain, **draw)
    )
    found = run(backend, 0.8)
    assert (found.state, found.ending, found.metrics) == (state, ending, {})
    assert found.unusable
    assert found.reason.startswith("the default, to which limits are relative, ")
    assert found.reason.endswith(f" in this context: {ended.reason}")
    assert [call["gain"] for call in backend.calls] == [DEFAULT]
    # It may have been chance.
    run(backend, 0.8)
    assert len(backend.calls) == 2


def test_a_failure_of_the_parameters_is_theirs(study):
    backend = FunctionBackend(
        study, lambda gain, **draw: failed("stalled") if gain > 0.7 else machine(gain, **draw)
    )
    found = run(backend, 0.8)
    assert (found.state, found.reason, found.unusable) == (EvaluationState.FAILED, "stalled", False)


def test_a_failed_run_of_the_default_itself_is_a_failure(study):
    found = run(FunctionBackend(study, lambda **_: failed("stalled")), DEFAULT)
    assert (found.state, found.reason, found.unusable) == (EvaluationState.FAILED, "stalled", False)


def test_a_difference_that_is_no_metric(study):
    def huge(gain, **_):
        return {"error": 1.0, "peak": -LARGEST_METRIC if gain == DEFAULT else LARGEST_METRIC}

    found = run(FunctionBackend(study, huge), 0.8)
    assert (found.state, found.metrics) == (EvaluationState.FAILED, {})
    assert found.reason.startswith("metric peak_minus_1.1_default is 2.1e+90, beyond")


def test_a_default_that_always_fails_ends_the_run_by_name(study):
    backend = FunctionBackend(
        study, lambda gain, **draw: failed("diverged") if gain == DEFAULT else machine(gain, **draw)
    )
    tuning = Tuning(study, Driver(backend), METHODS["IV"])
    with pytest.raises(RunError, match="3 trials in a row could not be prepared: the default, "):
        list(tuning)
    assert all(trial.unusable for trial in tuning.trials)


def test_the_limit_divides_the_trials_where_it_should(study):
    """At 1.1 times the default's gain, exactly, in every context and with every seed."""
    study = study.replace(trials=12, initial_trials=6)
    for trial in Tuning(study, Driver(FunctionBackend(study, machine)), METHODS["boundary"]):
        assert trial.state is TrialState.COMPLETE
        above = np.array([e.outcome.metrics["peak_minus_1.1_default"] for e in trial.evaluations])
        violated = study.constraints["calm"].violations(above)
        assert (violated == (trial.parameters["gain"] > 1.1 * DEFAULT)).all()


@pytest.mark.parametrize(("gain", "passed"), [(0.54, True), (0.56, False)])
def test_a_certificate(study, gain, passed):
    """A limit on the peak itself would tell neither from the other: it varies by a factor 14."""
    (evidence,) = collect(study, FunctionBackend(study, machine), 60, tuned=gain)
    assert judge(study, evidence, 0.95).passed is passed
