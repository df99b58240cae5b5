"""A run that ends once its outcome is decided, by what was recorded until then."""

import dataclasses

import pytest
from servo import study
from waiting import DEADLINE, wait_until

from bo_tuner.trials import Evaluation, EvaluationState, Stage

pytestmark = pytest.mark.ros

METRICS = {
    "far": {"of": "abs(angle)", "measure": "max", "unit": "rad"},
    "rough": {"of": "angle", "measure": "rms"},
}
STOP = {"publish": {"topic": "setpoint", "message": {"data": -0.5}}}
LONG = {"end": {"after": DEADLINE}, "timeout": DEADLINE, "after": [STOP]}
BUDGET = {"trials": 2, "initial_trials": 1, "cut_short": True}


def run(backend, **beyond):
    planned = Evaluation(0, 0, Stage.DRAWN, {"gain": 0.5}, {}, 1)
    return backend.outcome(dataclasses.replace(planned, beyond=beyond))


def test_it_ends_at_once_and_the_machine_is_brought_to_rest(backend, system):
    """The angle comes to 1; each run would take as long as a test may wait."""
    made = backend(run=LONG, metrics=METRICS, budget=BUDGET)
    for _ in range(2):
        outcome = run(made, far=0.8)
        assert outcome.state is EvaluationState.CUT_SHORT
        assert outcome.metrics == {}
        assert outcome.notes.at_least.keys() == {"error", "far"}
        assert 0.8 < outcome.notes.at_least["far"] <= 1.0
        assert outcome.notes.at_least["error"] > 0.0
        seconds = outcome.notes.cut_after
        assert 0.0 < seconds < DEADLINE
        far = f"far at least {outcome.notes.at_least['far']:.3g} rad"
        assert outcome.reason == f"cut short after {seconds:.3g} s: {far}"
        assert not outcome.unusable
        wait_until(lambda: system.setpoint == -0.5, "the machine is stopped")


def test_one_that_is_not_beyond_its_bound_is_whole(backend):
    made = backend(metrics=METRICS, budget=BUDGET)
    outcome = run(made, far=2.0, error=5.0)
    assert outcome.complete, outcome
    assert outcome.notes.at_least == {}
    assert outcome.metrics.keys() == {"error", "far", "rough"}


def test_signals_that_are_not_whole_fail_it_all_the_same(backend, system):
    """What was recorded would say less than it seems to."""
    made = backend(
        run=LONG,
        signals={
            "angle": {"topic": "joint_states", "field": "position[motor]", "largest_gap": 0.5}
        },
        metrics=METRICS,
        budget=BUDGET,
    )
    system.silent = True
    outcome = run(made, far=0.8)
    assert outcome.state is not EvaluationState.CUT_SHORT
    assert not study(metrics=METRICS).decisive_metrics
