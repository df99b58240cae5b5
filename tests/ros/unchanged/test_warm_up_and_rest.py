"""A machine warms up ahead of its first run, and rests between two runs with safe parameters."""

import pytest
from servo import SAFE, gain, run
from std_msgs.msg import Float64
from waiting import DEADLINE

from bo_tuner.trials import Evaluation, EvaluationState, Stage

pytestmark = pytest.mark.ros

PARK = {"parameters": {"gain": SAFE}}
COOL = {"heat": {"topic": "fault", "field": "data", "minimum_messages": 0}}
"""What the system publishes on /fault, as its temperature."""


def evaluation(value):
    return Evaluation(0, 0, Stage.DRAWN, {"gain": value}, {}, 1)


def test_runs_to_warm_up_come_first_and_count_nothing(backend, system):
    """With the parameters that the search begins with, whatever those of the evaluation are."""
    made = backend(run={"warm_up": 2}, start=[{"gain": 1.0}])
    extra = []
    made.after_extra_run = lambda: extra.append(gain(system))
    first, second = made.run([evaluation(0.5), evaluation(0.75)])
    assert extra == [1.0, 1.0]
    assert [e.outcome.notes.warm_ups for e in (first, second)] == [2, 0]
    assert [e.parameters["gain"] for e in (first, second)] == [0.5, 0.75]
    # The resets of `before`: two runs to warm up, and each evaluation.
    assert len(system.gains_at_reset) == 4


def test_a_machine_that_cannot_warm_up_is_no_fault_of_the_trial(backend, system):
    made = backend(run={"warm_up": 3, "abort_when": "angle > 0.9"})
    (done,) = made.run([evaluation(0.5)])
    assert done.outcome.unusable
    assert done.outcome.ending == "unprepared"
    assert done.outcome.reason.startswith("run 1 of 3 to warm up: aborted at ")
    # It begins again: nothing was learnt of the evaluation.
    (done,) = made.run([evaluation(0.5)])
    assert done.outcome.reason.startswith("run 1 of 3 to warm up: aborted at ")


def test_it_rests_with_the_safe_parameters(backend, system):
    made = backend(run={"rest": 0.5, "before": []}, park=PARK)
    first = run(made, 0.75)
    assert (first.state, first.notes.rested_seconds) == (EvaluationState.COMPLETE, 0.0)
    assert gain(system) == SAFE
    seen = []
    with made._tuner.also_watched_by(lambda: seen.append((gain(system), system.angle))):
        second = run(made, 0.75)
    assert second.state is EvaluationState.COMPLETE
    assert second.notes.rested_seconds > 0.0
    assert seen[0][0] == SAFE


def test_it_rests_until_a_condition_holds(backend, system):
    made = backend(
        signals=COOL, run={"rest": {"until": "heat < 40", "at_most": DEADLINE}}, park=PARK
    )
    resets = []

    def feel():
        resets.append(len(system.gains_at_reset))
        system.fault.publish(Float64(data=50.0 if len(resets) < 20 else 30.0))

    with made._tuner.also_watched_by(feel):
        outcome = run(made, 0.75)
    assert outcome.state is EvaluationState.COMPLETE, outcome.reason
    assert not any(resets[:20])
    assert len(system.gains_at_reset) == 1


def test_a_rest_without_an_end_is_no_fault_of_the_trial(backend, system):
    made = backend(run={"rest": {"until": "angle > 9", "at_most": 0.3}}, park=PARK)
    outcome = run(made, 0.75)
    assert outcome.ending == "unprepared"
    assert outcome.reason.startswith("run.rest.until: 'angle > 9' does not hold within 0.3 s (ang")
    assert gain(system) == SAFE
    assert system.setpoint == 0.0, "nothing was begun"
