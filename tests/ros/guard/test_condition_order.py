"""What a guard makes of the signals: each message counts, in the order in which they came."""

import pytest
import rclpy
from rclpy.context import Context
from rclpy.node import Node
from rclpy.qos import QoSProfile, QoSReliabilityPolicy
from std_msgs.msg import Float64
from waiting import wait_until

from bo_tuner.backends.ros.guard.condition import AbortCondition
from bo_tuner.backends.ros.guard.plan import Plan
from bo_tuner.study.signals import Signal

pytestmark = pytest.mark.ros


@pytest.fixture
def node(ros_environment):
    context = Context()
    rclpy.init(context=context)
    node = Node("machine", context=context)
    yield node
    node.destroy_node()
    context.try_shutdown()


def condition(node, text, *names):
    signals = {name: Signal(name=name, topic=name, field="data") for name in names}
    return AbortCondition(node, Plan("study", {}, {}, abort_when=text, signals=signals))


def publish(publisher, value):
    publisher.publish(Float64(data=value))


def test_a_single_message_counts_among_many(node):
    publisher = node.create_publisher(Float64, "angle", 100)
    made = condition(node, "angle > 3", "angle")
    wait_until(lambda: made.holds(0.0) or made.missing == [], "the topic")
    wait_until(lambda: publisher.get_subscription_count() == 1, "the subscription")
    for value in (0.0, 5.0, 0.0):
        publish(publisher, value)
    assert publisher.wait_for_all_acked()
    wait_until(lambda: made.holds(0.0), "the condition")
    assert not made.holds(0.0)


def test_messages_of_two_topics_are_judged_in_the_order_in_which_they_came(node):
    """They were never far apart, however many of them wait."""
    wanted, actual = (node.create_publisher(Float64, name, 100) for name in ("wanted", "actual"))
    made = condition(node, "abs(wanted - actual) > 1.5", "wanted", "actual")
    wait_until(lambda: made.holds(0.0) or made.missing == [], "the topics")
    for publisher in (wanted, actual):
        wait_until(lambda p=publisher: p.get_subscription_count() == 1, "the subscription")
    for value in range(8):
        for publisher in (wanted, actual):
            publish(publisher, float(value))
            assert publisher.wait_for_all_acked()
    held = []

    def all_heard():
        held.append(made.holds(0.0))
        return made._newest == {"wanted": 7.0, "actual": 7.0}

    wait_until(all_heard, "all messages")
    assert not any(held)


def test_of_two_publishers_the_one_that_promises_less_is_heard(node):
    for_all = node.create_publisher(Float64, "angle", 10)
    qos = QoSProfile(depth=10, reliability=QoSReliabilityPolicy.BEST_EFFORT)
    sensor = node.create_publisher(Float64, "angle", qos)
    wait_until(lambda: node.count_publishers("angle") == 2, "both publishers")
    made = condition(node, "angle > 3", "angle")
    wait_until(lambda: made.holds(0.0) or made.missing == [], "the topic")
    for publisher in (for_all, sensor):
        wait_until(lambda p=publisher: p.get_subscription_count() == 1, "the subscription")

    def heard():
        publish(sensor, 5.0)
        return made.holds(0.0)

    wait_until(heard, "the condition")
