"""`try` on running nodes: one run, the response as it was received, the nodes as they were."""

import json

import pytest
from commands import Fork, finish
from node_threads import at_work
from rclpy.node import Node
from std_msgs.msg import Float64

pytestmark = pytest.mark.ros

STUDY = {
    "name": "servo",
    "nodes": {"servo": {"node": "servo"}},
    "parameters": {"gain": {"node": "servo", "bounds": [0.0, 0.9], "default": 0.25}},
    "signals": {"angle": {"topic": "/angle", "field": "data"}},
    "run": {
        "start": [{"publish": {"topic": "/setpoint", "message": {"data": 1.0}}}],
        "end": {"when": "t > 0.3"},
    },
    "metrics": {"largest": {"of": "angle", "measure": "maximum"}},
    "constraints": {"largest": {"kind": "worst_case", "metric": "largest", "upper": 2.0}},
    "objective": {"metric": "largest"},
    "budget": {"trials": 3, "initial_trials": 2, "drawn_contexts": 1, "validation_draws": 2},
}


class Servo(Node):
    """Jumps to `gain` times the set-point, which it publishes at 100 Hz."""

    def __init__(self, context):
        super().__init__("servo", context=context)
        self.declare_parameter("gain", 0.25)
        self.angle = 0.0
        self.angles = self.create_publisher(Float64, "angle", 10)
        self.create_subscription(Float64, "setpoint", self.follow, 10)
        self.create_timer(0.01, lambda: self.angles.publish(Float64(data=self.angle)))

    def follow(self, message):
        self.angle = self.get_parameter("gain").value * message.data


def test_the_response_is_what_was_received(tmp_path):
    (tmp_path / "servo.yaml").write_text(json.dumps(STUDY))
    (tmp_path / "values.yaml").write_text("gain: 0.875\n")
    with at_work(Servo) as node:
        command = Fork("try", "servo.yaml", "--parameters", "values.yaml", folder=tmp_path)
        code, out, err = finish(command)
        # It is given back what it had.
        assert node.get_parameter("gain").value == 0.25
    assert (code, err) == (0, "")
    assert "0.875" in out
    assert "this run is within its limit\n" in out
    assert "response: runs/servo-try/response.png\n" in out
    assert "0.875" in (tmp_path / "runs" / "servo-try" / "response.html").read_text()
