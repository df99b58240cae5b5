"""Parameters go to their next values in small steps, so that the machine never jumps."""

import re
import threading
from pathlib import Path

import pytest
from servo import ROOM, SAFE, UNSTABLE, failure, gain, run, study

from bo_tuner.backends.ros.backend import RosBackend
from bo_tuner.interruption import Interrupted
from bo_tuner.trials import Evaluation, EvaluationState, Stage

pytestmark = pytest.mark.ros

RAMP = 0.4
"""Four steps."""
PARK = {"parameters": {"gain": SAFE}}
ODD = 0.1 + 0.2
"""A number that a sum of steps would miss in the last bit."""


def steps(first, last):
    """The gains that a node sees on its way, in tenths of a second, with the last one."""
    return [first + k / 4 * (last - first) for k in (1, 2, 3)] + [last]


def taken(system):
    """The gains that it was set to since this was last asked."""
    gains, system.asked_gains = system.asked_gains, []
    return gains


def ramped(backend, **run):
    return backend(run={"ramp": RAMP, "before": []} | run, park=PARK)


def test_to_the_safe_parameters_to_those_of_a_trial_and_back(backend, system):
    made = ramped(backend)
    assert taken(system) == pytest.approx(steps(0.5, SAFE)), "what ran before"
    outcome = run(made, ODD)
    assert outcome.state is EvaluationState.COMPLETE, outcome.reason
    assert (gains := taken(system)) == pytest.approx(steps(SAFE, ODD))
    assert gains[-1] == gain(system) == ODD
    assert outcome.notes.ramped_seconds >= RAMP
    assert run(made, ODD).notes.ramped_seconds == 0.0
    assert taken(system) == [], "of the same trial"
    assert made.park() == []
    assert taken(system) == pytest.approx(steps(ODD, SAFE)), "as in a pause"
    run(made, 1.0)
    taken(system)
    backend.opened.pop().close()
    # `park` names the gain, so that it stays safe.
    assert taken(system) == pytest.approx(steps(1.0, SAFE))


def test_what_the_nodes_had_before_comes_back_in_steps_too(system, tmp_path, patient):
    changes = {"run": {"ramp": RAMP, "before": []}, "park": PARK}
    made = RosBackend(study(**changes), Path(tmp_path), attach=True, keep_parked=False)
    made.open()
    taken(system)
    made.close()
    assert taken(system) == pytest.approx(steps(SAFE, 0.5))
    assert gain(system) == 0.5


def test_between_two_runs_it_goes_there_and_back(backend, system):
    made = backend(run={"ramp": RAMP}, park=PARK | {"between_runs": True})
    taken(system)
    outcome = run(made, 0.75)
    assert outcome.state is EvaluationState.COMPLETE, outcome.reason
    assert taken(system) == pytest.approx(steps(SAFE, 0.75) + steps(0.75, SAFE))
    assert system.gains_at_reset == [SAFE], "before the ramp"
    assert outcome.notes.ramped_seconds >= 2.0 * RAMP


def test_a_run_that_fails_is_parked_at_once(backend, system):
    made = ramped(backend, **ROOM)
    taken(system)
    assert failure(run(made, UNSTABLE)).startswith("aborted at ")
    assert taken(system) == pytest.approx([*steps(SAFE, UNSTABLE), SAFE])


def test_an_interruption_on_the_way_parks_at_once(interruptible, system):
    made = interruptible(lambda: gain(system) == 1.0, run={"ramp": RAMP, "before": []}, park=PARK)
    taken(system)
    # The second of its steps is 1.
    with pytest.raises(Interrupted):
        run(made, 2.0 - SAFE)
    assert taken(system) == pytest.approx([*steps(SAFE, 2.0 - SAFE)[:2], SAFE])
    assert system.setpoint == 0.0, "nothing was begun"


def test_at_the_end_an_interruption_parks_at_once(interruptible, system):
    """Such as one that came while a proposal was computed."""
    stopped = threading.Event()
    made = interruptible(stopped.is_set, run={"ramp": RAMP, "before": []}, park=PARK)
    run(made, 0.75)
    taken(system)
    stopped.set()
    made.close()
    assert taken(system) == [SAFE]


def test_a_refusal_on_the_way_fails_the_run_as_one_of_the_parameters_does(backend, system):
    made = ramped(backend)
    taken(system)
    answers = [True, False]
    system.accepts = lambda: answers.pop(0) if answers else True
    assert failure(run(made, 0.75)) == ("servo refused its parameters: it is at work (in the ramp)")
    assert taken(system) == pytest.approx([*steps(SAFE, 0.75)[:2], SAFE])


def test_a_refusal_on_the_way_to_the_safe_parameters_ends_the_ramp(backend, system):
    made = ramped(backend)
    run(made, 0.75)
    taken(system)
    answers = [True, False]
    system.accepts = lambda: answers.pop(0) if answers else True
    assert made.park() == []
    assert taken(system) == pytest.approx([*steps(0.75, SAFE)[:2], SAFE])


def test_a_change_by_somebody_else_on_the_way(backend, system):
    made = ramped(backend)
    values = [0.125]

    def disturb():
        if gain(system) > SAFE and values:
            system.set_gain(values.pop())

    with made._tuner.also_watched_by(disturb):
        outcome = run(made, 0.75)
    assert outcome.ending == "disturbed"
    assert outcome.reason.startswith("servo: parameter gain is 0.125, expected 0.75")


def test_a_tuner_that_is_killed_on_the_way_leaves_nothing_behind(
    backend, system, killed, tmp_path, monkeypatch
):
    """The next one knows the values of the steps for those of a tuner."""
    made = ramped(backend)

    class Killed(BaseException):
        pass

    def end(*_):
        raise Killed

    monkeypatch.setattr(made._opened.safe_state, "stop", list)
    with pytest.raises(Killed), made._tuner.also_watched_by(lambda: gain(system) > SAFE and end()):
        made.outcome(Evaluation(0, 0, Stage.DRAWN, {"gain": 0.75}, {}, 1))
    backend.opened.remove(made)
    killed(made)
    assert SAFE < gain(system) < 0.75
    said = []
    monkeypatch.setattr(
        "bo_tuner.backends.ros.tuner_node.TunerNode.warn", lambda _, t: said.append(t)
    )
    ramped(backend)
    assert re.fullmatch(r"servo is restored after a killed run: gain 0\.[0-9]+ -> 0\.5", said[0])
    assert taken(system)[-1] == SAFE
