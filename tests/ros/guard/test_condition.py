"""The abort condition as a guard sees it, by its own subscriptions."""

import math
import os
from functools import partial

import pytest
import rclpy
from field_robot import Driver, Frames, Scanner
from node_threads import at_work
from rclpy.context import Context
from rclpy.node import Node
from waiting import wait_until

from bo_tuner.backends.ros.guard.condition import AbortCondition
from bo_tuner.backends.ros.guard.plan import Plan
from bo_tuner.study.signals import Signal

pytestmark = pytest.mark.ros


@pytest.fixture
def guard():
    """A node as that of a guard, in no executor."""
    context = Context()
    rclpy.init(context=context, domain_id=int(os.environ["ROS_DOMAIN_ID"]))
    node = Node("condition", context=context)
    yield node
    node.destroy_node()
    context.try_shutdown()


def condition(guard, text, **signals):
    """The condition `text` of signals."""
    specs = {name: Signal(name=name, **keys) for name, keys in signals.items()}
    return AbortCondition(guard, Plan("study", {}, {}, abort_when=text, signals=specs))


def test_a_reduction(guard):
    clearance = {"topic": "scan", "field": "min(finite(ranges), range_max)"}
    with at_work(Scanner) as scanner:
        watched = condition(guard, "clearance < 0.3", clearance=clearance)
        assert watched.missing == ["clearance"]
        wait_until(lambda: watched.holds(1.0) or watched._newest["clearance"] == 2.5, "a value")
        assert not watched.holds(1.0)
        # An empty scan says nothing, and hides nothing that comes after it.
        scanner.ranges = []
        wait_until(lambda: watched.holds(1.0) or watched._newest["clearance"] == 30.0, "none")
        scanner.ranges = [math.nan, 0.2]
        wait_until(lambda: watched.holds(1.0), "an obstacle")


def test_the_one_of_several_publishers_that_the_study_names(guard):
    speed = {"topic": "cmd_vel", "field": "linear.x", "publisher": "driver"}
    with at_work(partial(Driver, name="joystick", value=9.0)), at_work(Driver) as driver:
        watched = condition(guard, "speed > 5", speed=speed)
        wait_until(lambda: watched.holds(1.0) or watched._newest["speed"] == 1.0, "the driver")
        assert not any(watched.holds(1.0) for _ in range(100))
        driver.value = 6.0
        wait_until(lambda: watched.holds(1.0), "too fast")


def test_where_one_frame_is_in_another(guard):
    x = {"topic": "frames", "frames": ["map", "base"], "field": "translation.x"}
    odometry = partial(_frames, "odom", "base", 1.0)
    with at_work(partial(_frames, "map", "odom", 2.0)), at_work(odometry) as base:
        watched = condition(guard, "x > 5", x=x)
        wait_until(lambda: watched.holds(1.0) or watched._newest["x"] == 3.0, "the chain")
        assert not watched.holds(1.0)
        base.x = 4.0
        wait_until(lambda: watched.holds(1.0), "too far")


def _frames(parent, child, x, context):
    return Frames(parent, child, context=context, x=x)
