"""Between runs, in a pause and at the end the machine runs with safe parameters, and comes home."""

import json
import os
import threading

import pytest
from node_threads import at_work
from rcl_interfaces.msg import SetParametersResult
from rclpy.node import Node
from servo import failure, run
from waiting import DEADLINE, wait_until

from bo_tuner.backends.ros import suspension
from bo_tuner.backends.ros.errors import DisturbedError, LostError
from bo_tuner.errors import BackendError
from bo_tuner.interruption import Interrupted
from bo_tuner.storage.state import state_folder
from bo_tuner.trials import Evaluation, EvaluationState, Stage

pytestmark = pytest.mark.ros

SAFE, GOOD, UNSTABLE = 0.25, 0.5, 2.5
HOME = {"publish": {"topic": "setpoint", "message": {"data": 0.0}}}
ROOM = {
    "abort_when": "abs(angle) > 3",
    "end": {"when": "abs(angle - 1) < 0.05"},
    "timeout": 60.0,
}
"""A run ends where a stable step response comes to, and has the time that a busy machine takes."""


def gain(system):
    return system.get_parameter("gain").value


def test_after_a_bad_trial_the_machine_is_safe_and_home(backend, system):
    """The step response grows without bounds: |1 - 2.5| > 1, and nothing else brings it back."""
    home = {"wait_until": {"condition": "abs(angle) < 0.01", "timeout": 60.0}}
    made = backend(
        run={"before": [], **ROOM, "recover": [HOME, home]}, park={"parameters": {"gain": SAFE}}
    )
    assert gain(system) == SAFE, "as soon as the backend is open"
    assert failure(run(made, UNSTABLE)).startswith("aborted at ")
    assert gain(system) == SAFE
    assert abs(system.angle) < 0.01
    assert run(made, GOOD).state is EvaluationState.COMPLETE
    assert gain(system) == GOOD


def test_without_safe_ones_the_defaults_are_safe(backend, system):
    made = backend(run=ROOM)
    failure(run(made, UNSTABLE))
    assert gain(system) == 0.5


def test_in_a_pause(backend, system):
    made = backend(run={"before": []}, park={"parameters": {"gain": SAFE}})
    run(made, 0.75)
    assert gain(system) == 0.75
    assert made.park() == []
    assert gain(system) == SAFE
    assert run(made, 0.75).state is EvaluationState.COMPLETE


def test_between_two_runs_and_while_one_is_prepared(backend, system):
    made = backend(park={"parameters": {"gain": SAFE}, "between_runs": True})
    outcome = run(made, 0.75)
    assert outcome.state is EvaluationState.COMPLETE, outcome.reason
    assert (system.gains_at_reset, gain(system)) == ([SAFE], SAFE)


def test_a_preparation_that_fails_with_the_safe_parameters_is_no_fault_of_the_trial(
    backend, system
):
    never = {"wait_until": {"condition": "angle > 9", "timeout": 0.3}}
    stop = {"publish": {"topic": "setpoint", "message": {"data": -0.5}}}
    made = backend(
        run={"before": [never], "after": [stop]},
        park={"parameters": {"gain": SAFE}, "between_runs": True},
    )
    outcome = run(made, 0.75)
    assert outcome.spoilt
    assert outcome.reason.startswith(
        "the preparation with the safe parameters failed: run.before[0]: 'angle > 9' does not hold"
    )
    wait_until(lambda: system.setpoint == -0.5, "the steps after the run")


def test_a_preparation_that_somebody_else_made_fail(backend, system):
    moving = {"publish": {"topic": "setpoint", "message": {"data": 1.0}}}
    never = {"wait_until": {"condition": "angle > 9", "timeout": 2.0}}
    made = backend(
        run={"before": [moving, never]}, park={"parameters": {"gain": SAFE}, "between_runs": True}
    )
    values = [0.125]

    def disturb():
        if system.setpoint == 1.0 and values:
            system.set_gain(values.pop())

    with made._tuner.also_watched_by(disturb):
        outcome = run(made, 0.75)
    assert outcome.spoilt
    changed = "servo: parameter gain is 0.125, expected 0.25 (changed by someone else)"
    assert outcome.reason.startswith(changed)


def test_a_node_that_refuses_a_trial(backend, system):
    made = backend(run=ROOM)
    with system.refusing("the key is out"):
        reason = failure(run(made, UNSTABLE))
    assert reason.startswith("servo refused its parameters: the key is out")


def test_a_node_that_does_not_take_its_safe_values_is_named_at_once(refusal, system):
    with system.refusing("the key is out"):
        reason = refusal(park={"parameters": {"gain": SAFE}})
    assert reason == "park: as safe values: servo refused its parameters: the key is out"


@pytest.mark.parametrize(
    ("name", "default", "complaint"),
    [
        ("gian", 0.5, "the node has no parameter 'gian'; did you mean 'gain'"),
        ("serial", 8.0, "'serial' is read-only in the node"),
        ("count", 2.5, "'count' is of type integer in the node, not double"),
        ("limited", 1.5, "9 lies outside the range of 'limited' in the node, [0, 2]"),
    ],
)
def test_a_parameter_that_the_node_does_not_have_as_the_study_says(
    refusal, name, default, complaint
):
    """It is found before the first trial, and not once in each."""
    parameter = {"node": "servo", "type": "double", "bounds": [0, 9], "default": default}
    reason = refusal(parameters={name: parameter})
    assert reason.startswith(f"parameters.{name}: {complaint}"), reason


def test_a_context_variable_that_the_node_does_not_have(refusal):
    context = {"node": "servo", "distribution": "uniform", "bounds": [1, 2], "nominal": 1}
    reason = refusal(contexts={"laod": context})
    assert reason.startswith("contexts.laod: the node has no parameter 'laod'; "), reason


def test_a_context_that_the_node_does_not_take_in_full(refusal):
    """It is found before the first trial, not in those that draw from what is beyond."""
    context = {"node": "servo", "distribution": "uniform", "bounds": [1, 3], "nominal": 1}
    reason = refusal(contexts={"limited": context})
    assert reason == ("contexts.limited: 3 lies outside the range of 'limited' in the node, [0, 2]")


def test_a_failure_to_park_is_told(backend, system):
    made = backend(run={"before": [], **ROOM})
    system.refuses_beyond = 2.0
    reason = failure(run(made, UNSTABLE))
    assert reason.startswith("aborted at ")
    assert "; servo is not parked: servo refused its parameters: the key is out" in reason


def test_a_machine_that_does_not_come_home(backend, system):
    home = {"wait_until": {"condition": "angle > 9", "timeout": 0.3}}
    made = backend(run={**ROOM, "recover": [HOME, {"wait": 0.3}, home]})
    reason = failure(run(made, UNSTABLE))
    assert reason.startswith("aborted at ")
    assert (
        "; not recovered: run.recover[2]: 'angle > 9' does not hold for 0.1 s within 0.3 s (angle "
    ) in reason


def test_at_the_end_the_steps_after_a_run_are_done_and_the_node_has_what_it_had(backend, system):
    system.set_gain(0.375)
    made = backend(run={"before": []})
    run(made, 0.75)
    made.close()
    assert gain(system) == 0.375


def test_safe_values_that_the_study_names_stay(backend, system, capfd):
    system.set_gain(0.375)
    park = {"parameters": {"gain": SAFE}}
    made = backend(run={"before": []}, park=park)
    run(made, 0.75)
    made.close()
    assert gain(system) == SAFE
    said = "servo is left with the park values: gain 0.25 (was 0.375)"
    assert capfd.readouterr().err.count(said) == 1
    # What the node has already is not worth a line.
    backend(run={"before": []}, park=park).close()
    assert "park values" not in capfd.readouterr().err


class Filter(Node):
    """Has an array, and two numbers of which one must not be above the other."""

    def __init__(self, context):
        super().__init__("filter", context=context)
        self.declare_parameter("noise", [0.25, 0.5])
        self.declare_parameter("control", 5)
        self.declare_parameter("prediction", 8)
        self.add_on_set_parameters_callback(self.judge)

    def judge(self, parameters):
        new = {parameter.name: parameter.value for parameter in parameters}
        control, prediction = (
            new.get(name, self.get_parameter(name).value) for name in ("control", "prediction")
        )
        return SetParametersResult(successful=control <= prediction, reason="too few steps")

    @property
    def values(self):
        noise, *numbers = (
            self.get_parameter(name).value for name in ("noise", "control", "prediction")
        )
        return [list(noise), *numbers]


@pytest.fixture
def filter_parked(backend, join):
    """Function that opens a backend for a filter beside the servo, and closes it again."""

    def make(**values):
        node = join(Filter)
        of_filter = {"node": "filter"}
        integer = of_filter | {"type": "integer", "bounds": [1, 30]}
        made = backend(
            nodes={
                "servo": {"node": "servo"},
                "filter": of_filter | {"parameters": {"noise": [1.0, 2.0]}},
            },
            parameters={
                "gain": {"node": "servo", "type": "double", "bounds": [0, 3], "default": 0.5},
                "noise[0]": of_filter | {"type": "double", "bounds": [0, 3], "default": 1.0},
                "control": integer | {"default": 5},
                "prediction": integer | {"default": 20},
            },
            park={"parameters": values},
        )
        parked = node.values
        made.close()
        return parked, node.values

    return make


def test_of_an_array_only_the_items_that_the_study_names_stay(filter_parked, capfd):
    parked, left = filter_parked(**{"noise[0]": 0.75})
    assert (parked, left) == ([[0.75, 2.0], 5, 20], [[0.75, 0.5], 5, 8])
    said = "filter is left with the park values: noise [0.75, 0.5] (was [0.25, 0.5])"
    assert said in capfd.readouterr().err


def test_a_node_that_refuses_the_safe_values_beside_its_own_has_its_own_again(filter_parked, capfd):
    """Ten steps of control go with the default of 20 steps of prediction, but not with 8."""
    parked, left = filter_parked(control=10)
    assert (parked, left) == ([[1.0, 2.0], 10, 20], [[0.25, 0.5], 5, 8])
    said = "filter is left with what it had, and not with the park values: filter refused its"
    assert said in capfd.readouterr().err


@pytest.fixture
def killed():
    """Function that lets a backend go as `kill -9` does: it says nothing to the nodes any more."""

    def kill(backend):
        backend._procedure.close()
        backend._tuner.close()
        backend._claim.release()
        backend._procedure = backend._tuner = backend._claim = None

    return kill


@pytest.mark.parametrize("park", [{}, {"parameters": {"gain": SAFE}, "between_runs": True}])
def test_what_a_killed_tuner_has_left_is_not_what_the_node_had(backend, system, killed, park):
    system.set_gain(0.375)
    made = backend(run={"before": []}, park=park)
    assert run(made, 0.75).state is EvaluationState.COMPLETE
    killed(made)
    assert gain(system) == (SAFE if park else 0.75)
    backend(run={"before": []}).close()
    assert gain(system) == 0.375
    # That is forgotten then.
    system.set_gain(0.75)
    backend(run={"before": []}).close()
    assert gain(system) == 0.75


def test_a_kill_before_the_node_has_the_next_parameters(backend, system, killed):
    """It has those of the trial before then, which are not its own either."""
    system.set_gain(0.375)
    made = backend(run={"before": []})
    assert run(made, 0.75).state is EvaluationState.COMPLETE
    for value in (0.8, 0.9):
        made._previous.tell({"servo": {"gain": value}})
        # As of a node that does not answer.
        made._client.parameters.forget("servo")
    killed(made)
    backend(run={"before": []}).close()
    assert gain(system) == 0.375


def test_what_somebody_has_set_since_a_tuner_was_killed_stays(backend, system, killed):
    made = backend(run={"before": []})
    run(made, 0.75)
    killed(made)
    system.set_gain(0.625)
    backend(run={"before": []}).close()
    assert gain(system) == 0.625


def test_a_node_that_is_not_set_back_is_told_and_set_back_by_the_next_command(backend, system):
    system.set_gain(0.375)
    made = backend(run={"before": []})
    run(made, 0.75)
    with system.refusing("the key is out"):
        complaint = "^servo is not set back: servo refused its parameters: the key is out; the next"
        with pytest.raises(BackendError, match=complaint):
            made.close()
    backend(run={"before": []}).close()
    assert gain(system) == 0.375


def test_what_a_killed_tuner_has_left_and_the_node_does_not_take_back(backend, system, killed):
    made = backend(run={"before": []})
    run(made, 0.75)
    killed(made)
    complaint = "^servo is not set back: servo refused its parameters: the key is out"
    with system.refusing("the key is out"), pytest.raises(BackendError, match=complaint):
        backend(run={"before": []})


def test_what_nodes_of_other_studies_had_stays_noted(backend, system):
    """The command that works on them may come later."""
    note = state_folder() / "attached" / f"domain{os.environ['ROS_DOMAIN_ID']}.json"
    note.parent.mkdir(parents=True, exist_ok=True)
    other = {"arm": {"previous": {"kp": 1.0}, "told": {"kp": [2.0]}}}
    note.write_text(json.dumps(other))
    try:
        made = backend(run={"before": []})
        assert json.loads(note.read_text()).keys() == {"arm", "servo"}
        made.close()
        assert json.loads(note.read_text()) == other
    finally:
        note.unlink()


def test_a_run_goes_on_where_nothing_can_be_noted(backend, system, tmp_path, monkeypatch, capfd):
    (tmp_path / "file").touch()
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "file"))
    made = backend(run={"before": []})
    assert run(made, 0.75).state is EvaluationState.COMPLETE
    made.close()
    assert gain(system) == 0.5
    warning = "cannot be written: Not a directory; after a kill the nodes cannot be set back"
    assert warning in capfd.readouterr().err


@pytest.mark.parametrize("phase", ["before", "start"])
def test_an_interrupted_run_stops_the_machine_ahead_of_all_else(
    interruptible, system, monkeypatch, phase
):
    """As Ctrl-C does, when it moves: not only when the backend is closed, after the records."""
    moving = [{"publish": {"topic": "setpoint", "message": {"data": 1.0}}}, {"wait": DEADLINE}]
    steps = {
        "before": [],
        "start": [],
        "end": {"after": 2 * DEADLINE},
        "timeout": 2 * DEADLINE,
        "after": [
            {"call": {"service": "servo/enable", "request": {"data": False}}},
            {"publish": {"topic": "setpoint", "message": {"data": -0.5}}},
        ],
    }
    made = interruptible(lambda: system.setpoint == 1.0, run=steps | {phase: moving})
    said = []
    monkeypatch.setattr(made._tuner, "warn", said.append)
    with pytest.raises(Interrupted):
        run(made, 0.75)
    # The first of the steps is refused, which does not keep the next one from being done.
    wait_until(lambda: system.setpoint == -0.5, "the steps after the run")
    assert gain(system) == 0.5
    # It has no other record.
    assert said == ["run.after[0]: /servo/enable refused: the brake is on"]


def test_a_node_that_is_not_parked_after_an_interruption_is_told(
    interruptible, system, monkeypatch
):
    moving = [{"publish": {"topic": "setpoint", "message": {"data": 1.0}}}, {"wait": DEADLINE}]
    made = interruptible(lambda: system.setpoint == 1.0, run={"before": moving})
    said = []
    monkeypatch.setattr(made._tuner, "warn", said.append)
    system.accepts = lambda: system.setpoint != 1.0
    with pytest.raises(Interrupted):
        run(made, 0.75)
    assert said == ["servo is not parked: servo refused its parameters: it is at work"]
    system.accepts = lambda: True


def test_an_interruption_ahead_of_an_evaluation_sets_nothing(interruptible, system):
    """The parameters of a trial that is not to be run reach no node."""
    interrupting = []
    made = interruptible(lambda: interrupting, run={"before": []})
    interrupting.append(True)
    asked = system.asked_to_set
    with pytest.raises(Interrupted):
        run(made, 0.75)
    assert system.asked_to_set == asked


def test_an_interruption_of_a_suspended_tuner_keeps_a_run_from_being_repeated(
    interruptible, system, monkeypatch
):
    """Of the parameters it has shown nothing."""
    interrupting, passed = [], [0.0]
    made = interruptible(lambda: interrupting, run={"before": [], **ROOM})
    now, evaluate = suspension._now, made._client.evaluate
    monkeypatch.setattr(suspension, "_now", lambda: now() + passed[0])

    def suspended(*arguments):
        try:
            return evaluate(*arguments)
        finally:
            passed[0] += 2 * suspension.LONGEST
            interrupting.append(True)

    monkeypatch.setattr(made._client, "evaluate", suspended)
    with pytest.raises(Interrupted):
        run(made, UNSTABLE)
    assert len(interrupting) == 1


def test_what_a_run_has_shown_is_kept_when_the_way_home_is_interrupted(interruptible, system):
    """The parameters are not run again, and the machine does not go on driving."""
    leaving = {"publish": {"topic": "setpoint", "message": {"data": 0.25}}}
    made = interruptible(
        lambda: system.setpoint == 0.25,
        run={
            "before": [],
            **ROOM,
            "after": [{"publish": {"topic": "setpoint", "message": {"data": -0.5}}}],
            "recover": [leaving, {"wait": DEADLINE}],
        },
    )
    assert failure(run(made, UNSTABLE)).startswith("aborted at ")
    wait_until(lambda: system.setpoint == -0.5, "the steps after the run")


def test_an_interruption_while_a_machine_is_stopped_keeps_it_from_driving_home(
    interruptible, system, monkeypatch
):
    """It does not end the steps after the run, but what follows on them."""
    rest = {"wait_until": {"condition": "angle < -0.2", "timeout": DEADLINE}}
    made = interruptible(
        lambda: system.setpoint == -0.5,
        run={
            "before": [],
            "after": [{"publish": {"topic": "setpoint", "message": {"data": -0.5}}}, rest],
            "recover": [{"publish": {"topic": "setpoint", "message": {"data": 0.25}}}],
        },
    )
    published, publisher = [], made._procedure._publishers["/setpoint"]
    publish = publisher.publish

    def noting(message):
        published.append(message.data)
        publish(message)

    def disturbed():
        if made._procedure._is_recording:
            raise DisturbedError("the clock was set")

    publisher.publish = noting
    monkeypatch.setattr(made._procedure._clock, "look", disturbed)
    assert failure(run(made)).startswith("the clock was set")
    assert set(published) == {1.0, -0.5}


def test_a_machine_that_does_not_come_home_is_brought_to_rest(backend, system):
    leaving = {"publish": {"topic": "setpoint", "message": {"data": 0.25}}}
    never = {"wait_until": {"condition": "angle > 9", "timeout": 0.3}}
    made = backend(
        run={
            "before": [],
            **ROOM,
            "after": [{"publish": {"topic": "setpoint", "message": {"data": -0.5}}}],
            "recover": [leaving, never],
        }
    )
    assert "; not recovered: run.recover[1]: " in failure(run(made, UNSTABLE))
    wait_until(lambda: system.setpoint == -0.5, "the steps after the run")


def test_the_machine_is_stopped_before_the_reason_is_looked_for(backend, system, monkeypatch):
    """A node that hangs is waited for, and one that was started anew; the machine does not wait."""
    stop = {"publish": {"topic": "setpoint", "message": {"data": -0.5}}}
    made = backend(run={"before": [], **ROOM, "after": [stop]}, park={"parameters": {"gain": SAFE}})
    found = []

    def note(*_):
        wait_until(lambda: system.setpoint == -0.5, "the steps after the run")
        found.append(gain(system))

    monkeypatch.setattr(made._client.parameters, "expect_answer", note)
    monkeypatch.setattr(made._client, "_refuse_other_nodes", note)
    assert failure(run(made, UNSTABLE)).startswith("aborted at ")
    assert found == [SAFE, SAFE]


def test_a_machine_that_is_not_parked_does_not_drive_home(backend, system):
    """With the parameters of the trial it would."""
    made = backend(run={"before": [], **ROOM, "recover": [HOME]})
    system.refuses_beyond = 2.0
    reason = failure(run(made, UNSTABLE))
    assert "; servo is not parked: servo refused its parameters: the key is out" in reason
    assert system.setpoint == 1.0


class Hanging(Node):
    """Has a gain, too, and answers only while it does not hang."""

    def __init__(self, context):
        super().__init__("hanging", context=context)
        self.declare_parameter("gain", 0.5)
        self.free, self.hangs = threading.Event(), threading.Event()
        self.free.set()
        self.create_timer(0.01, self.hang)

    def hang(self):
        if not self.free.is_set():
            self.hangs.set()
            self.free.wait()


def test_a_node_that_hangs_keeps_no_other_from_being_parked(backend, system):
    """Both are asked at once: the machine is to stop."""
    double = {"type": "double", "bounds": [0.0, 3.0], "default": 0.5}
    with at_work(Hanging) as hanging:
        made = backend(
            nodes={"hanging": {"node": "hanging"}, "servo": {"node": "servo"}},
            parameters={
                "hanging": {"node": "hanging", "parameter": "gain", **double},
                "gain": {"node": "servo", **double},
            },
            run={"before": []},
            park={"parameters": {"gain": SAFE}},
        )
        trial = {"gain": 0.75, "hanging": 0.75}
        outcome = made.outcome(Evaluation(0, 0, Stage.DRAWN, trial, {}, 1))
        assert outcome.state is EvaluationState.COMPLETE, outcome.reason

        def look():
            if gain(system) == SAFE:
                hanging.free.set()

        # Asked while nodes are parked, too.
        made._interrupted = look
        hanging.free.clear()
        assert hanging.hangs.wait(DEADLINE)
        try:
            assert made.park() == []
        finally:
            hanging.free.set()
        assert gain(hanging) == 0.5
        made.close()


def test_between_two_runs_the_machine_is_parked_before_the_run_is_judged(
    backend, system, monkeypatch
):
    """A node that was killed is looked for as long as its lease, and a metric takes its time."""
    made = backend(park={"parameters": {"gain": SAFE}, "between_runs": True})
    found = []

    def noting(owner, name):
        done = getattr(owner, name)
        note = lambda *arguments: found.append(gain(system)) or done(*arguments)  # noqa: E731
        monkeypatch.setattr(owner, name, note)

    noting(made._client, "_refuse_other_nodes")
    noting(made._collector, "outcome")
    outcome = run(made, 0.75)
    assert outcome.state is EvaluationState.COMPLETE, outcome.reason
    assert found == [SAFE, SAFE]


@pytest.mark.parametrize("refusals", [1, 2])
def test_a_node_that_is_not_parked_after_a_run_is_told_again_and_then_named(
    backend, system, monkeypatch, refusals
):
    made = backend(park={"parameters": {"gain": SAFE}, "between_runs": True})
    said = []
    monkeypatch.setattr(made._tuner, "warn", said.append)
    # It takes the gain of the trial, and not at once the safe one after it.
    answers = [True, *[False] * refusals]
    system.accepts = lambda: answers.pop(0) if answers else True
    outcome = run(made, 0.75)
    assert outcome.state is EvaluationState.COMPLETE, outcome.reason
    problem = "servo is not parked: servo refused its parameters: it is at work"
    assert said == [problem] * (refusals > 1)
    assert ("park" in outcome.details) == (refusals > 1)
    assert gain(system) == (SAFE if refusals == 1 else 0.75)


def test_a_disturbed_run_is_stopped_before_the_reason_is_looked_for(backend, system, monkeypatch):
    stop = {"publish": {"topic": "setpoint", "message": {"data": -0.5}}}
    made = backend(run={"before": [], "after": [stop]}, park={"parameters": {"gain": SAFE}})
    found = []

    def disturbed():
        raise DisturbedError("the clock was set")

    def note():
        wait_until(lambda: system.setpoint == -0.5, "the steps after the run")
        found.append(gain(system))

    monkeypatch.setattr(made._procedure._clock, "look", disturbed)
    monkeypatch.setattr(made._client, "_refuse_other_nodes", note)
    assert failure(run(made, 0.75)) == "the clock was set"
    assert found == [SAFE]


def test_a_machine_that_two_command_does_not_drive_home(backend, system, join, leave, monkeypatch):
    """Which of them has the safe parameters is not known."""
    for module in ("study_client", "safe_state"):
        monkeypatch.setattr(f"bo_tuner.backends.ros.{module}.LONGEST_LEASE", 0.1)
    home = {"publish": {"topic": "setpoint", "message": {"data": -0.5}}}
    made = backend(run={"before": [], "recover": [home]})
    second = join(Node, "servo")
    servers = made._client.parameters.clients["servo"].servers
    wait_until(lambda: servers() == 2, "both")
    reason = failure(run(made, 0.75))
    twins = f"servo runs more than once in ROS domain {os.environ['ROS_DOMAIN_ID']}"
    # Either of them may answer, so that parking may have failed, too.
    assert reason.startswith(f"{twins}; ")
    leave(second)
    wait_until(lambda: servers() == 1, "the second one is gone")
    made.close()
    assert system.setpoint != -0.5


def test_a_node_that_ends_while_a_second_one_is_waited_for_is_told(backend, system, monkeypatch):
    home = {"publish": {"topic": "setpoint", "message": {"data": -0.5}}}
    made = backend(run={"before": [], "recover": [home]})

    def twins(_timeout):
        raise LostError("servo has ended")

    monkeypatch.setattr(made._client.presence, "twins", twins)
    outcome = run(made)
    assert outcome.state is EvaluationState.LOST
    assert outcome.reason == "servo has ended; not recovered: servo has ended"
    assert system.setpoint != -0.5


def test_an_objective_without_a_logarithm_leaves_the_machine_safe_and_home(backend, system):
    """That fails an evaluation as all else does."""
    home = {"publish": {"topic": "setpoint", "message": {"data": -0.5}}}
    made = backend(
        objective={"metric": "error", "scale": "log"},
        metrics={"error": {"of": "setpoint - setpoint", "measure": "rms"}},
        run={"before": [], "recover": [home]},
        park={"parameters": {"gain": SAFE}},
    )
    assert failure(run(made, 0.75)) == "metric error is 0.0; its log scale needs a positive value"
    assert gain(system) == SAFE
    wait_until(lambda: system.setpoint == -0.5, "the way home")


def test_what_goes_wrong_in_the_end_keeps_nothing_from_being_tried(backend, system, monkeypatch):
    system.set_gain(0.375)
    made = backend(run={"before": []})
    run(made, 0.75)

    def park():
        raise RuntimeError("unexpected")

    monkeypatch.setattr(made, "park", park)
    with pytest.raises(RuntimeError, match="unexpected"):
        made.close()
    assert gain(system) == 0.375
