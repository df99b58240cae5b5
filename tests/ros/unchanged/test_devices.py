"""Nodes that are other than most: they lack services, keep 32 bits, change or lack values.

As MAVROS (``param.cpp``) and rclc on a microcontroller (``parameter_server.c``) make them.
"""

import contextlib
import os
from functools import partial

import numpy as np
import pytest
from commands import run as command
from devices import TWO, Device
from node_threads import at_work
from rcl_interfaces.msg import ParameterDescriptor
from rclpy.parameter import Parameter
from servo import SAFE, System, failure, gain, run, study

from bo_tuner.backends.ros.backend import RosBackend
from bo_tuner.backends.ros.guard.guard import Guard, PipeBeats
from bo_tuner.backends.ros.guard.messages import IDLE, Beat
from bo_tuner.backends.ros.guard.plan import Patience, Plan
from bo_tuner.deploy.apply import ApplyError, set_values
from bo_tuner.deploy.bundle import differences
from bo_tuner.deploy.live_parameters import LiveParameters
from bo_tuner.study.study_file import load_study
from bo_tuner.trials import Evaluation, EvaluationState, Stage

pytestmark = pytest.mark.ros

DEVICES = {
    "without the service": {},
    "of a flight controller": {"atomic": "device do not support atomic set"},
    "of a microcontroller": {"atomic": "Unimplemented service", "room": 1},
    "that cannot read more": {"atomic": "", "room": 1, "is_mute": True},
    "with words of its own": {"atomic": "use the other one"},
    "without a list": {"lacks": ["list_parameters", "describe_parameters"]},
}


def run_two(backend, gain, limited):
    parameters = {"gain": gain, "limited": limited}
    return backend.outcome(Evaluation(0, 0, Stage.DRAWN, parameters, {}, 1))


@pytest.fixture
def device(patient, tmp_path, monkeypatch):
    """Function that makes a device, with what makes it different, and lets it work."""
    monkeypatch.setattr("bo_tuner.backends.ros.tuner_node.CALL_TIMEOUT", 2.0)
    with contextlib.ExitStack() as stack:
        yield lambda **kind: stack.enter_context(at_work(partial(Device, **kind)))


@pytest.fixture
def attached(tmp_path):
    """Function that opens a backend for a study of the device."""
    with contextlib.ExitStack() as stack:

        def make(*, keep_parked=True, **changes):
            made = RosBackend(study(**changes), tmp_path, attach=True, keep_parked=keep_parked)
            stack.callback(made.close)
            made.open()
            return made

        yield make


@pytest.fixture
def live():
    """Function that connects to the device as `apply` does."""
    with contextlib.ExitStack() as stack:
        yield lambda: stack.enter_context(
            contextlib.closing(LiveParameters(["servo"], [], lambda: None))
        )


@pytest.mark.parametrize("kind", DEVICES.values(), ids=DEVICES.keys())
def test_it_is_set_read_back_and_given_back(device, attached, kind):
    system = device(**kind)
    system.set_gain(0.75)
    made = attached(park={"parameters": {"gain": SAFE}}, keep_parked=False)
    outcome = run(made, 0.375)
    assert outcome.state is EvaluationState.COMPLETE, outcome
    assert ["gain"] in system.requests
    made.park()
    assert gain(system) == SAFE
    made.close()
    assert gain(system) == 0.75


@pytest.mark.parametrize("kind", DEVICES.values(), ids=DEVICES.keys())
def test_a_refusal_leaves_all_as_it_was(device, attached, kind):
    """Whatever was set before the one that is refused."""
    system = device(**kind)
    made = attached(parameters=TWO)
    system.refused = {"limited": "the key is out"}
    reason = failure(run_two(made, 0.375, 1.5))
    assert reason == "servo refused its parameters: limited: the key is out"
    assert "gain" in [name for names in system.requests for name in names]
    assert (gain(system), system.get_parameter("limited").value) == (0.5, 1.0)


def test_a_limit_that_is_refused_until_the_other_one_is_set(device, attached):
    """The order is that of the study, and not always the one that a node takes."""
    system = device()
    system.set_gain(1.5)
    system.least = {"gain": "limited"}
    made = attached(parameters=TWO | {"gain": TWO["gain"] | {"default": 1.5}})
    assert run_two(made, 0.75, 0.5).state is EvaluationState.COMPLETE
    assert (gain(system), system.get_parameter("limited").value) == (0.75, 0.5)
    system.least = {}


def test_what_cannot_be_set_back_is_named(device, attached):
    system = device()
    made = attached(parameters=TWO)
    system.refused = {"limited": "not now"}
    system.stays = {"gain"}
    reason = failure(run_two(made, 0.375, 1.5))
    system.stays.clear()
    assert "limited: not now; gain could not be set back: it stays" in reason


def test_a_value_that_others_set_is_found_on_it_too(device, attached):
    system = device()
    made = attached()
    assert run(made).state is EvaluationState.COMPLETE
    system.set_parameters([Parameter("count", value=5)])
    reason = failure(run(made))
    assert reason.startswith("servo: parameter count is 5, expected 3 (changed by someone else)")


def test_it_is_told_what_a_node_does_not_offer(device, attached, capfd):
    device(lacks=["list_parameters"])
    attached()
    said = capfd.readouterr().err
    assert "servo: no service set_parameters_atomically: it sets no parameters together" in said
    assert "servo: no service list_parameters: only what the study sets is read and held" in said


def test_apply_sets_it_or_leaves_all_as_it_was(device, live):
    system = device(atomic="device do not support atomic set")
    nodes = live()
    before = {"servo": {"gain": 0.5, "limited": 1.0}}
    new = {"servo": {"gain": 0.375, "limited": 1.5}}
    set_values(nodes, before, new)
    assert (gain(system), system.get_parameter("limited").value) == (0.375, 1.5)
    (remark,) = nodes.take_remarks()
    assert remark.startswith("servo: sets no parameters together")
    system.refused = {"limited": "the key is out"}
    with pytest.raises(ApplyError) as caught:
        set_values(nodes, new, {"servo": {"gain": 0.75, "limited": 2.0}})
    assert str(caught.value).startswith("servo refuses: limited: the key is out")
    assert (gain(system), system.get_parameter("limited").value) == (0.375, 1.5)


@pytest.mark.parametrize("kind", DEVICES.values(), ids=DEVICES.keys())
def test_the_guard_leaves_it_safe(device, kind):
    system = device(**kind)
    plan = Plan.of(study(parameters=TWO, park={"parameters": {"gain": SAFE, "limited": 0.5}}))
    beats, told = os.pipe()
    with os.fdopen(beats), os.fdopen(told, "wb") as pipe:
        guard = Guard(
            plan,
            [],
            PipeBeats(beats),
            name="g",
            patience=Patience(9.0, 9.0),
            attached=True,
            record=None,
            say=print,
        )
        try:
            guard.open(wait=False, alone=False)
            pipe.write(f"{Beat('g', IDLE, 0, 0)}\n".encode())
            pipe.close()
            guard.serve()
        finally:
            guard.close()
    assert (gain(system), system.get_parameter("limited").value) == (SAFE, 0.5)


def test_a_device_that_keeps_32_bits_has_what_it_was_told(device, attached):
    """What it holds is on record; a context, a constant and a parameter of the study alike."""
    system = device(is_float32=True)
    held = float(np.float32(0.15))
    made = attached(parameters=TWO)
    outcome = run_two(made, 0.15, 0.3)
    assert outcome.state is EvaluationState.COMPLETE, outcome
    assert gain(system) == held != 0.15
    assert outcome.notes.held["servo.gain"] == held
    # It is not told again what it has.
    told = len(system.requests)
    assert run_two(made, 0.15, 0.3).state is EvaluationState.COMPLETE
    assert len(system.requests) == told
    outcome = run_two(made, 0.25, 0.5)
    assert not outcome.notes.held


def test_more_than_32_bits_can_tell_is_not_taken(device, attached):
    system = device(is_float32=True)
    made = attached()
    system.offset = 1e-6
    reason = failure(run(made, 0.15))
    assert reason.endswith("(not taken by the node)"), reason
    system.offset = 0.0


def test_apply_on_a_device_of_32_bits(device, live):
    system = device(is_float32=True)
    nodes = live()
    set_values(nodes, {"servo": {"gain": 0.5}}, {"servo": {"gain": 0.15}})
    assert gain(system) == float(np.float32(0.15))
    found = {"servo": nodes.get("servo", ["gain"])}
    told = len(system.requests)
    set_values(nodes, found, {"servo": {"gain": 0.15}})
    assert len(system.requests) == told
    (row,) = differences(study(), found, {"servo": {"gain": 0.15}})
    assert row.equal


@pytest.fixture
def counting():
    """Function that lets a device count by itself, every 50 ms, until the end."""
    timers = []

    def begin(system):
        def count():
            number = system.get_parameter("count").value + 1
            system.set_parameters([Parameter("count", value=number)])

        timers.append((system, system.create_timer(0.05, count)))

    yield begin
    for system, timer in timers:
        system.destroy_timer(timer)


def test_what_a_node_changes_by_itself_is_left_to_it(device, attached, counting):
    system = device()
    counting(system)
    made = attached(nodes={"servo": {"node": "servo", "unwatched": ["cou*"]}})
    assert run(made, 0.375).state is EvaluationState.COMPLETE
    made.close()
    # A later part of the run does not take it for a change either.
    made = attached(nodes={"servo": {"node": "servo", "unwatched": ["count"]}})
    assert run(made, 0.375).state is EvaluationState.COMPLETE
    number = system.get_parameter("count").value
    made.close()
    assert system.get_parameter("count").value >= number > 3


def test_the_error_offers_it_where_nobody_sets_the_parameter(device, attached, counting):
    system = device()
    made = attached(parameters=TWO)
    counting(system)
    reason = failure(run_two(made, 0.375, 0.5))
    assert reason.endswith(
        ", expected 3 (changed by someone else); if the node does that by itself: "
        "unwatched: [count] in nodes.servo"
    ), reason


def test_init_sees_it(device, counting, tmp_path):
    system = device()
    counting(system)
    code, out, err = command("init", folder=tmp_path)
    assert (code, err) == (0, ""), out
    made = load_study(tmp_path / "study.yaml")
    assert made.nodes["servo"].unwatched == ("count",)
    assert list(made.parameters) == ["gain"]
    text = (tmp_path / "study.yaml").read_text()
    assert "# CHECK: unwatched has changed by itself" in text
    assert "# count of servo: the node changes it by itself" in text


class Partly(System):
    """Takes what it has not declared, and has declared two parameters without giving them a value.

    So has an estimator whose file does not give all covariances.
    """

    def __init__(self, context):
        super().__init__(context, allow_undeclared_parameters=True)
        self.declare_parameter("typed", Parameter.Type.DOUBLE)
        self.declare_parameter("any", None, ParameterDescriptor(dynamic_typing=True))
        # A node whose author deletes none.
        self.remove_on_set_parameters_callback(self.judge)


@pytest.fixture
def partly(patient):
    with at_work(Partly) as node:
        yield node


def unset_study(**others):
    number = {"node": "servo", "type": "double", "bounds": [0.0, 2.0], "default": 1.0}
    return study(parameters=dict.fromkeys(("free", "typed", "any"), number), **others)


@pytest.mark.parametrize("is_killed", [False, True])
def test_what_had_no_value_has_none_again(partly, tmp_path, killed, capfd, is_killed):
    made = RosBackend(unset_study(), tmp_path, attach=True)
    made.open()
    planned = Evaluation(0, 0, Stage.DRAWN, {"free": 0.5, "typed": 0.75, "any": 1.5}, {}, 1)
    assert made.outcome(planned).state is EvaluationState.COMPLETE
    assert partly.get_parameter("free").value == 0.5
    if is_killed:
        killed(made)
        made = RosBackend(unset_study(), tmp_path, attach=True)
        made.open()
    made.close()
    assert not partly.has_parameter("free")
    assert [partly.get_parameter(name).value for name in ("typed", "any")] == [1.0, 1.0]
    said = capfd.readouterr().err
    assert ("free 0.5 -> not set" in said) == is_killed
    assert "servo: free" not in said
    for name in ("typed", "any") if not is_killed else ():
        assert (
            f"servo: {name} was not set before, and cannot be again: it is declared, and would "
            "be no longer"
        ) in said


def test_what_had_no_value_stays_parked_if_the_study_says_so(partly, tmp_path):
    made = RosBackend(unset_study(park={"parameters": {"free": 0.25}}), tmp_path, attach=True)
    made.open()
    made.close()
    assert partly.get_parameter("free").value == 0.25
