"""Nodes in other namespaces, parameters of joints, and lists: what ROS takes, and a study, too."""

import contextlib

import pytest
import rclpy
from commands import run as command
from node_threads import at_work
from rclpy.context import Context
from rclpy.node import Node
from servo import System, study

from bo_tuner.backends.ros.backend import RosBackend
from bo_tuner.deploy.live_parameters import LiveParameters
from bo_tuner.errors import BackendError
from bo_tuner.storage.parameter_file import from_yaml, node_values, to_yaml
from bo_tuner.trials import Evaluation, EvaluationState, Stage

pytestmark = pytest.mark.ros

NAMES = {
    "wrist": "gains.ur5e/shoulder_pan_joint.p",
    "elbow": "left-elbow",
    "grip": "arm:wrist",
    "spaced": "a b",
}
DOUBLE = {"node": "servo", "type": "double", "bounds": [0.0, 9.0], "default": 1.0}
LISTS = {
    "weights": {"type": "double_array", "choices": [[1.0, 2.0], [0.5]], "default": [1.0, 2.0]},
    "frames": {"type": "string_array", "choices": [["map"], ["y", "1e5"]], "default": ["map"]},
}
OF_LISTS = {"weights": "[0.5]", "frames": '["y", "1e5"]'}
TRIAL = {"wrist": 0.25, "elbow": 0.5, "grip": 2.5, "spaced": 3.0}


class Arm(System):
    """The servo in a namespace, with gains of joints."""

    def __init__(self, context):
        super().__init__(context, namespace="/arm")
        for name in NAMES.values():
            self.declare_parameter(name, 1.0)
        for name, item in LISTS.items():
            self.declare_parameter(name, item["default"])

    @property
    def lists(self):
        return [list(self.get_parameter(name).value) for name in LISTS]

    @property
    def gains(self):
        return {key: self.get_parameter(name).value for key, name in NAMES.items()}


@pytest.fixture
def arm(patient):
    with at_work(Arm) as node:
        yield node


def arm_study(node="/arm/servo", **others):
    lists = {name: {"node": "servo", **item} for name, item in LISTS.items()}
    return study(
        nodes={"servo": {"node": node}},
        parameters={key: DOUBLE | {"parameter": name} for key, name in NAMES.items()} | lists,
        signals={
            "setpoint": {"topic": "/arm/setpoint", "field": "data"},
            "angle": {"topic": "/arm/joint_states", "field": "position[motor]"},
        },
        run={
            "before": [{"call": {"service": "/arm/servo/reset"}}],
            "start": [{"publish": {"topic": "/arm/setpoint", "message": {"data": 1.0}}}],
        },
        **others,
    )


def test_they_are_set_and_given_back(arm, tmp_path):
    made = RosBackend(arm_study(), tmp_path, attach=True)
    made.open()
    outcome = made.outcome(Evaluation(0, 0, Stage.DRAWN, TRIAL | OF_LISTS, {}, 1))
    assert outcome.state is EvaluationState.COMPLETE, outcome
    assert arm.gains == TRIAL
    assert arm.lists == [[0.5], ["y", "1e5"]]
    made.close()
    assert arm.gains == dict.fromkeys(NAMES, 1.0)
    assert arm.lists == [[1.0, 2.0], ["map"]]


def test_apply_sets_them(arm):
    values = node_values(arm_study(), TRIAL | OF_LISTS)
    assert list(values) == ["/arm/servo"]
    with contextlib.closing(LiveParameters(list(values), [], lambda: None)) as live:
        live.set("/arm/servo", values["/arm/servo"])
    assert arm.gains == TRIAL
    assert arm.lists == [[0.5], ["y", "1e5"]]


def test_ros_reads_them_from_the_file_of_a_result(ros_environment, tmp_path):
    """As `--params-file`, by its own parser."""
    values = node_values(arm_study(), TRIAL | OF_LISTS)
    text = to_yaml(values)
    assert from_yaml(text) == values
    (tmp_path / "parameters.yaml").write_text(text)
    context = Context()
    arguments = ["--ros-args", "--params-file", str(tmp_path / "parameters.yaml")]
    rclpy.init(args=arguments, context=context)
    node = Node(
        "servo",
        namespace="/arm",
        context=context,
        automatically_declare_parameters_from_overrides=True,
    )
    try:
        assert {k: node.get_parameter(n).value for k, n in NAMES.items()} == TRIAL
        lists = [list(node.get_parameter(name).value) for name in LISTS]
        assert lists == [[0.5], ["y", "1e5"]]
    finally:
        node.destroy_node()
        context.try_shutdown()


def test_a_node_that_is_not_there_is_named_in_full(arm, tmp_path, monkeypatch):
    monkeypatch.setattr("bo_tuner.backends.ros.bringup.ATTACH_TIMEOUT", 1.0)
    made = RosBackend(arm_study("/leg/servo"), tmp_path, attach=True)
    with contextlib.closing(made), pytest.raises(BackendError) as caught:
        made.open()
    assert str(caught.value).startswith("/leg/servo: no such node in ROS domain ")
    assert "arm/servo" in str(caught.value)


def test_init_gives_them_names_for_a_study(arm, tmp_path):
    code, out, err = command(
        *("init", "--nodes", "arm/servo", "--parameters"),
        *(f"arm/servo:{name}" for name in NAMES.values()),
        folder=tmp_path,
    )
    assert (code, err) == (0, ""), out
    code, out, err = command("check", "study.yaml", folder=tmp_path)
    assert "the nodes match the study: 4 parameters" in out, (out, err)
