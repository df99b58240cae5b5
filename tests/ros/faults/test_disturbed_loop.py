"""A loop whose messages come late, twice and in the wrong order."""

import random
import time

import pytest
from milling_nodes import Loop
from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState

from milling_plant.cut import MillingPlant
from mpc_controller.controller import MpcController

pytestmark = [pytest.mark.ros, pytest.mark.slow]

NAMESPACE = ("-r", "__ns:=/disturbed")
SHORT = {"reference_levels": [0.5, 0.8], "samples_per_level": 25, "seed": 7}


class Disturbance:
    """Between two topics: hands messages on late, some twice, and with older ones after them."""

    def __init__(self, peer, source, target, rng):
        self._rng = rng
        self._waiting = []
        self._older = []
        self.repeated = 0
        self._publisher = peer.node.create_publisher(JointState, target, QoSProfile(depth=100))
        peer.node.create_subscription(JointState, source, self._take, QoSProfile(depth=100))
        peer.node.create_timer(0.001, self._hand_on)

    def connected(self):
        return self._publisher.get_subscription_count() > 0

    def _take(self, message):
        now = time.monotonic()
        self._waiting.append((now + self._rng.uniform(0.0, 0.02), message))
        if self._rng.random() < 0.3:
            self._waiting.append((now + self._rng.uniform(0.0, 0.1), message))
        if self._older and self._rng.random() < 0.3:
            self._waiting.append((now + 0.03, self._rng.choice(self._older)))
        self._older = [*self._older[-5:], message]

    def _hand_on(self):
        now = time.monotonic()
        due = [item for item in self._waiting if item[0] <= now]
        self._waiting = [item for item in self._waiting if item[0] > now]
        for _, message in sorted(due, key=lambda item: item[0]):
            self._publisher.publish(message)


def test_late_repeated_and_reordered_messages_change_no_figure(start_node, make_peer):
    start_node("milling_plant", *NAMESPACE, "-r", "mpc_controller/command:=disturbed/command")
    start_node("mpc_controller", *NAMESPACE, "-r", "joint_states:=disturbed/joint_states")
    peer = make_peer("/disturbed")
    rng = random.Random(4)
    ways = [
        Disturbance(peer, "mpc_controller/command", "disturbed/command", rng),
        Disturbance(peer, "joint_states", "disturbed/joint_states", rng),
    ]
    peer.spin_until(lambda: all(way.connected() for way in ways), "both nodes")
    loop = Loop(peer)
    loop.set("milling_plant", **SHORT, resend_period=0.05, command_timeout=20.0)
    loop.set("mpc_controller", return_time="modelled")

    plant, controller = MillingPlant(), MpcController()
    plant.set_parameters(SHORT)
    controller.set_parameters({"return_time": "modelled"})
    expected = plant.run_cut(controller) | controller.cut_result()
    own = ("status", "reason", "samples", "seed")
    for _ in range(2):
        cut = loop.start_cut()
        of_plant, of_controller = (
            {item.key: item.value for item in loop.result(node, cut).status[0].values}
            for node in ("milling_plant", "mpc_controller")
        )
        assert of_plant["status"] == of_controller["status"] == "ok"
        assert int(of_plant["ignored_messages"]) > 0
        for key, value in expected.items():
            if key not in own:
                assert (of_plant | of_controller)[key] == (
                    value if isinstance(value, str) else repr(value)
                )
