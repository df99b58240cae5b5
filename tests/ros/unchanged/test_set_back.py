"""In the end an attached node has what it had, also after a tuner that was killed."""

import contextlib
import json
import os

import pytest
from in_process import call
from made_runs import INITIAL, make_run
from rcl_interfaces.msg import SetParametersResult
from rclpy.node import Node
from rclpy.parameter import Parameter
from servo import SAFE, gain, run, study
from waiting import DEADLINE

from bo_tuner.backends.ros import others
from bo_tuner.backends.ros.backend import RosBackend
from bo_tuner.backends.ros.graph import describe, opened_node
from bo_tuner.backends.ros.parameters.previous import undo_killed
from bo_tuner.cli import apply
from bo_tuner.deploy.live_parameters import LiveParameters
from bo_tuner.errors import BackendError
from bo_tuner.storage.state import state_folder
from bo_tuner.trials import Evaluation, EvaluationState, Stage

pytestmark = pytest.mark.ros


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


def before_tuning(made):
    return made._previous.before_tuning["servo"]["gain"]


@pytest.mark.parametrize("again", [{}, {"parameters": {"gain": 0.3}}])
def test_what_ran_before_is_known_through_runs_that_leave_the_node_parked(
    backend, system, killed, again
):
    system.set_gain(0.375)
    backend(run={"before": []}, park={"parameters": {"gain": SAFE}}).close()
    made = backend(run={"before": []}, park=again)
    assert before_tuning(made) == 0.375
    run(made, 0.75)
    killed(made)
    made = backend(run={"before": []}, park=again)
    assert (before_tuning(made), made._previous._previous["servo"]["gain"]) == (0.375, SAFE)
    made.close()
    assert gain(system) == (0.3 if again else SAFE)
    made = backend(run={"before": []})
    assert before_tuning(made) == 0.375
    made.close()
    # Since then somebody has set it.
    system.set_gain(0.5)
    made = backend(run={"before": []})
    assert before_tuning(made) == 0.5


@pytest.mark.parametrize("note", ["kept", "damaged"])
def test_apply_rolls_back_to_what_ran_before_the_run(system, patient, tmp_path, capsys, note):
    """The run leaves the node with the park values, which nobody ran before."""
    system.set_gain(0.375)
    parked = study(run={"before": []}, park={"parameters": {"gain": SAFE}}, budget=INITIAL)
    path = tmp_path / "run"
    made = RosBackend(parked, path / "log", attach=True)
    record = make_run(path, parked, made, result=1, backend_name="ros", attached=True)
    assert gain(system) == SAFE
    (noted,) = (path / "log").glob("previous_parameters.json")
    if note == "damaged":
        noted.write_text("{}")
    before = 0.375 if note == "kept" else 0.5
    for set_first in (False, True):
        if set_first:
            system.set_gain(SAFE)
            code, _, err = call(apply, capsys, path, "--yes", "--without-certificate")
            assert code == 0, err
            assert gain(system) == record.trials[1].parameters["gain"]
        code, out, err = call(apply, capsys, path, "--rollback", "--yes")
        assert code == 0, err
        if note == "damaged" and set_first:
            # Nothing tells that somebody else had set the park values on purpose.
            before = SAFE
        assert gain(system) == before
        if not set_first:
            what = "what ran before tune" if note == "kept" else "the study's default"
            assert what in " ".join(out.split())


def test_what_somebody_has_set_since_the_run_is_the_way_back(system, patient, tmp_path, capsys):
    system.set_gain(0.375)
    parked = study(run={"before": []}, park={"parameters": {"gain": SAFE}}, budget=INITIAL)
    path = tmp_path / "run"
    made = RosBackend(parked, path / "log", attach=True)
    make_run(path, parked, made, result=1, backend_name="ros", attached=True)
    system.set_gain(0.625)
    for arguments in (("--without-certificate",), ("--rollback",)):
        assert call(apply, capsys, path, "--yes", *arguments)[0] == 0
    assert gain(system) == 0.625


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


def test_what_a_step_had_set_is_restored_after_a_kill(backend, system, killed):
    """As is what a step of `after` has left."""
    setting = {"node": "servo", "parameter": "count"}
    had = system.get_parameter("count").value
    made = backend(
        run={
            "start": [{"set": setting | {"value": 7}}],
            "after": [{"set": setting | {"value": 0}}],
        },
        signals={"setpoint": {"topic": "/plain", "field": "data[0]"}},
    )
    run(made)
    system.set_parameters([Parameter("count", value=7)])
    killed(made)
    made = backend(run={"before": []})
    assert system.get_parameter("count").value == had
    made.close()


def test_nobody_takes_what_a_killed_tuner_has_left_for_the_nodes_own(
    backend, system, killed, monkeypatch
):
    for name in ("backends.ros.graph.DISCOVERY", "backends.ros.graph.ANSWER"):
        monkeypatch.setattr(f"bo_tuner.{name}", DEADLINE)
    monkeypatch.setattr("bo_tuner.deploy.live_parameters.DISCOVERY_TIMEOUT", DEADLINE)
    system.set_gain(0.375)
    made = backend(run={"before": []})
    run(made, 0.75)
    killed(made)
    with opened_node([], lambda: None) as tuner:
        assert describe(tuner, "servo")["gain"].value == 0.375
    assert gain(system) == 0.75
    with contextlib.closing(LiveParameters(["servo"], [], lambda: None)) as live:
        now = live.get("servo", ["gain"])
        assert now == {"gain": 0.75}
        assert live.before_killed("servo", now) == {"gain": 0.375}
        # As somebody who has set just this.
        live.forget_killed("servo", now)
    backend(run={"before": []}).close()
    assert gain(system) == 0.75


def test_a_check_that_finds_mistakes_sets_back_what_a_killed_tuner_has_left(
    backend, system, killed
):
    system.set_gain(0.375)
    made = backend(run={"before": []})
    run(made, 0.75)
    killed(made)
    with opened_node([], lambda: None) as tuner:
        assert tuner.wait_until(lambda: "servo" in others.nodes(tuner.node), DEADLINE)
        undo_killed(study(), tuner)
    assert gain(system) == 0.375
    # That is done, so what somebody sets now is meant.
    system.set_gain(0.75)
    backend(run={"before": []}).close()
    assert gain(system) == 0.75


def test_a_kill_before_the_first_trial(backend, system, killed):
    """The constants of the study are set by then."""
    constant = {"servo": {"node": "servo", "parameters": {"count": 5}}}
    killed(backend(run={"before": []}, nodes=constant))
    assert system.get_parameter("count").value == 5
    backend(run={"before": []}, nodes=constant).close()
    assert system.get_parameter("count").value == 3


def test_what_the_tuner_itself_has_set_was_left_by_none_that_was_killed(backend, system, capfd):
    """It has noted that down before it asks the node for its ranges."""
    backend(run={"before": []}, nodes={"servo": {"node": "servo", "parameters": {"count": 5}}})
    assert system.get_parameter("count").value == 5
    assert capfd.readouterr().err == ""


class Empty(Node):
    """Has an array of doubles without an item."""

    def __init__(self, context):
        super().__init__("filter", context=context)
        self.declare_parameter("noise", Parameter.Type.DOUBLE_ARRAY)
        self.set_parameters([Parameter("noise", Parameter.Type.DOUBLE_ARRAY, [])])


def test_an_array_that_was_empty(backend, system, join):
    """rclpy takes an empty list for one of bytes."""
    node = join(Empty)
    nodes = {
        "servo": {"node": "servo"},
        "filter": {"node": "filter", "parameters": {"noise": [1.0, 2.0]}},
    }
    made = backend(run={"before": []}, nodes=nodes)
    assert list(node.get_parameter("noise").value) == [1.0, 2.0]
    made.close()
    found = node.get_parameter("noise")
    assert (list(found.value), found.type_) == ([], Parameter.Type.DOUBLE_ARRAY)


def test_a_kill_before_the_node_has_the_next_parameters(backend, system, killed):
    """It has those of the trial before then, which are not its own either."""
    system.set_gain(0.375)
    made = backend(run={"before": []})
    assert run(made, 0.75).state is EvaluationState.COMPLETE
    for value in (0.8, 0.9):
        made._previous.announce({"servo": {"gain": value}})
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
        complaint = (
            "^servo could not be restored: servo refused its parameters: the key is out; the next"
        )
        with pytest.raises(BackendError, match=complaint):
            made.close()
    backend(run={"before": []}).close()
    assert gain(system) == 0.375


def test_a_node_that_refuses_until_it_is_at_rest_is_asked_again(backend, system, patience):
    """As one that still moves after a run that failed."""
    patience(DEADLINE)
    system.set_gain(0.375)
    made = backend(run={"before": []})
    run(made, 0.75)
    asked = []

    def accepts():
        asked.append(True)
        # What parks the node is refused first.
        return len(asked) > 4

    system.accepts = accepts
    made.close()
    assert gain(system) == 0.375


@pytest.mark.parametrize("park", [{}, {"parameters": {"gain": SAFE}}])
def test_what_a_killed_tuner_has_left_and_the_node_does_not_take_back(
    backend, system, killed, park
):
    made = backend(run={"before": []}, park=park)
    run(made, 0.75)
    killed(made)
    complaint = "^servo could not be restored: servo refused its parameters: the key is out"
    with system.refusing("the key is out"), pytest.raises(BackendError, match=complaint):
        backend(run={"before": []}, park=park)


def test_what_nodes_of_other_studies_had_stays_noted(backend, system):
    """The command that works on them may come later."""
    note = state_folder() / "attached" / f"domain{os.environ['ROS_DOMAIN_ID']}.json"
    note.parent.mkdir(parents=True, exist_ok=True)
    entry = {"previous": {"kp": 1.0}, "assigned": {"kp": [2.0]}, "original": {}, "undeclared": []}
    other = {"/arm": entry}
    note.write_text(json.dumps(other))
    try:
        made = backend(run={"before": []})
        assert json.loads(note.read_text()).keys() == {"/arm", "/servo"}
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
    warning = "cannot be written: Not a directory; after a kill the nodes cannot be restored"
    assert warning in capfd.readouterr().err


def test_what_goes_wrong_in_the_end_keeps_nothing_from_being_tried(backend, system, monkeypatch):
    system.set_gain(0.375)
    made = backend(run={"before": []})
    run(made, 0.75)

    def park(**options):
        raise RuntimeError("unexpected")

    monkeypatch.setattr(made._opened.safe_state, "park", park)
    with pytest.raises(RuntimeError, match="unexpected"):
        made.close()
    assert gain(system) == 0.375


def test_without_its_condition_a_node_keeps_what_it_had(backend, system):
    number = {"node": "servo", "type": "double"}
    parameters = {
        "gain": number | {"bounds": [0.0, 1.0], "default": 0.25},
        "limited": number | {"bounds": [0.0, 2.0], "default": 1.5, "when": "gain > 0.4"},
    }
    made = backend(parameters=parameters)
    for gain_, expected in ((0.3, 1.0), (0.75, 0.5), (0.3, 1.0), (0.75, 0.5)):
        values = {"gain": gain_, "limited": 0.5 if gain_ > 0.4 else 1.5}
        outcome = made.outcome(Evaluation(0, 0, Stage.DRAWN, values, {}, 1))
        assert outcome.state is EvaluationState.COMPLETE, outcome
        assert system.get_parameter("limited").value == expected
    made.close()
    assert (gain(system), system.get_parameter("limited").value) == (0.5, 1.0)
