"""Steps that set parameters which the study does not vary: held in the run, and given back."""

import pytest
from rclpy.parameter import Parameter
from servo import SAFE, failure, gain, run
from servo import study as servo_study

from bo_tuner.backends.ros.guard.plan import Plan
from bo_tuner.errors import StudyError
from bo_tuner.run_notes import Unusable
from bo_tuner.trials import EvaluationState

pytestmark = pytest.mark.ros

HAD = 3
"""The count of the servo, of which the study says nothing."""
LONG = {"end": {"after": 1.5}}


def setting(value, parameter="count", node="servo"):
    return {"set": {"node": node, "parameter": parameter, "value": value}}


def count(system):
    return system.get_parameter("count").value


@pytest.fixture
def history(system):
    """The counts that the servo was set to, one after the other."""
    found = []

    def note(parameters):
        found.extend(item.value for item in parameters if item.name == "count")

    system.set_parameters([Parameter("count", value=HAD)])
    system.add_post_set_parameters_callback(note)
    yield found
    system.remove_post_set_parameters_callback(note)
    system.set_parameters([Parameter("count", value=HAD)])


def complete(outcome):
    assert outcome.state is EvaluationState.COMPLETE, outcome.reason


@pytest.mark.parametrize("phase", ["before", "start"])
@pytest.mark.parametrize("between_runs", [False, True])
def test_a_parameter_is_set_for_a_run_and_given_back(
    backend, system, history, in_run, phase, between_runs
):
    """That it changes is not somebody else's doing, and the gain is that of the trial in it."""
    start = servo_study().run.start
    assert len(start) == 1
    publish = {"publish": {"topic": "setpoint", "message": {"data": 1.0}}}
    steps = {"start": [publish]} | {phase: [publish, setting(7), setting(8)]}
    made = backend(run=LONG | steps, park={"between_runs": between_runs})
    held = []
    for value in (0.5, 0.75):
        in_run(made, lambda: held.append((count(system), gain(system))))
        complete(run(made, value))
        assert count(system) == HAD
    assert held == [(8, 0.5), (8, 0.75)]
    assert history == [7, 8, HAD] * 2
    made.close()
    assert count(system) == HAD


def test_what_a_step_after_the_run_sets_stays_until_the_next_one(backend, system, history):
    """A machine with a set-point that is a parameter stands still between two runs."""
    made = backend(run={"start": [setting(7)], "after": [setting(0)]}, signals=UNHEARD)
    # From the beginning, too: what the node had may move the machine.
    assert count(system) == 0
    for _ in range(2):
        complete(run(made))
        assert count(system) == 0
    assert history == [0, 7, 0, 7, 0]
    made.close()
    assert count(system) == HAD


UNHEARD = {"setpoint": {"topic": "/plain", "field": "data[0]"}}


@pytest.mark.parametrize("after", [[], [setting(0)]])
def test_a_run_that_fails_gives_it_back(backend, system, history, after):
    made = backend(
        run=LONG | {"start": [setting(7)], "abort_when": "t > 0.2", "after": after},
        signals=UNHEARD,
    )
    assert "aborted" in failure(run(made))
    assert count(system) == (0 if after else HAD)
    assert 7 in history


def test_a_step_on_the_way_home_is_given_back_then(backend, system, history):
    made = backend(
        run=LONG | {"abort_when": "t > 0.2", "recover": [setting(9)]},
    )
    assert "aborted" in failure(run(made))
    assert history == [9, HAD]


def test_what_somebody_else_changes_then_is_told(backend, system, history, in_run):
    made = backend(run=LONG | {"start": [setting(7)]}, signals=UNHEARD)
    in_run(made, lambda: system.set_parameters([Parameter("count", value=1)]))
    outcome = run(made)
    assert failure(outcome) == "servo: parameter count is 1, expected 7 (changed by someone else)"
    assert outcome.notes.unusable is Unusable.DISTURBED
    # Nor is it left so.
    complete(run(made))
    assert count(system) == HAD


def test_a_node_that_does_not_take_it(backend, system, history):
    made = backend(run={"start": [setting(7)]}, signals=UNHEARD)
    system.accepts = lambda: count(system) != HAD
    assert failure(run(made)).startswith("run.start[0]: servo refused its parameters: it is at wor")
    system.accepts = lambda: True
    complete(run(made))


@pytest.mark.parametrize(
    ("step", "complaint"),
    [
        (setting(1, "cont"), "set: the node has no parameter 'cont'; did you mean 'count'?"),
        (setting(1.5), "set: 'count' is of type integer in the node, not double"),
        (setting(1, "limited"), "set: 'limited' is of type double in the node; write 1.0"),
        (setting(3.0, "limited"), "set: 3 lies outside the range of 'limited' in the node, [0, 2]"),
        (setting(3.0, "serial"), "set: 'serial' is read-only in the node"),
    ],
)
def test_what_the_node_says_that_it_does_not_take(refusal, step, complaint):
    assert refusal(run={"start": [step]}, signals=UNHEARD).startswith(f"run.start[0].{complaint}")


@pytest.mark.parametrize(
    ("step", "complaint"),
    [
        (setting(1.0, "gain"), "set.parameter: 'gain' of node 'servo' is set by parameters.gain"),
        (setting(1, node="serv"), "set.node: there is no node 'serv'; did you mean 'servo'?"),
        (setting({}), "set.value: expected a number, text, true, false or a list of these"),
        (setting(1, "a b"), "set.parameter: expected a parameter name"),
        ({"set": {"node": "servo", "parameter": "count"}}, "set.value: missing"),
    ],
)
def test_what_no_step_can_set(step, complaint):
    with pytest.raises(StudyError) as caught:
        servo_study(run={"start": [step]})
    assert str(caught.value).startswith(f"run.start[0].{complaint}")


def test_a_guard_leaves_what_a_step_after_the_run_sets():
    made = servo_study(
        run={"start": [setting(7), setting(8.0, "limited")], "after": [setting(0)]},
        nodes={"servo": {"node": "servo", "parameters": {"limited": 1.0}}},
        park={"parameters": {"gain": SAFE}},
    )
    assert Plan.of(made).safe == {"servo": {"gain": SAFE, "count": 0, "limited": 1.0}}
