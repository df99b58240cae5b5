"""Which running node is the plant of a controller."""

import pytest

from bo_tuner.study.descriptors import Described
from bo_tuner.study.roles import is_commanded, is_plant
from bo_tuner.study.seen import SeenNode, SeenTopic


def node(*parameters):
    return SeenNode("x", {name: Described("double", 1.0) for name in parameters})


def topics(hears, publishes):
    return [
        SeenTopic(hears, "std_msgs/msg/Float64", {"data": 0.0}, ("a",), ("x",)),
        SeenTopic(publishes, "std_msgs/msg/Float64", {"data": 0.0}, ("x",), ("a",)),
    ]


@pytest.mark.parametrize(
    ("parameters", "hears", "publishes", "expected"),
    [
        (("vibration", "gyro_bias"), "/torque", "/imu", True),
        (("inertia", "rate"), "/motor/command", "/joint_states", True),
        (("noise",), "/cmd_vel", "/odom", True),
        # One that commands somebody itself is a controller, whatever it has.
        (("kp", "payload"), "/setpoint", "/torque", False),
        # An estimator hears measurements, and its noise is to be tuned.
        (("process_noise", "gyro_bias"), "/imu", "/estimate", False),
        (("alpha",), "/command", "/odom", False),
    ],
)
def test_a_plant_hears_a_command_publishes_and_has_what_plants_have(
    parameters, hears, publishes, expected
):
    assert is_plant(node(*parameters), topics(hears, publishes)) is expected


@pytest.mark.parametrize(
    ("hears", "publishes", "expected"),
    [
        ("/torque", "/joint_states", True),
        ("/imu", "/estimate", False),
        ("/setpoint", "/torque", False),
    ],
)
def test_one_that_is_only_commanded_is_not_tuned_beside_its_controller(hears, publishes, expected):
    """Its gain may be that of a motor."""
    assert is_commanded(node("gain", "k"), topics(hears, publishes)) is expected
