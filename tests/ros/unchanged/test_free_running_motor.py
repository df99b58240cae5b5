"""The recipe for a free-running machine, on a motor that sticks, under an integrating PID."""

import math
from pathlib import Path

import pytest
import yaml
from node_threads import at_work
from rclpy.node import Node
from rclpy.parameter import Parameter
from sensor_msgs.msg import JointState
from signal_runs import signal_study
from std_msgs.msg import Float64
from std_srvs.srv import Trigger

from bo_tuner.backends.ros.backend import RosBackend
from bo_tuner.errors import RunError
from bo_tuner.methods.registry import METHODS
from bo_tuner.study.study_file import study_from_mapping
from bo_tuner.trials import Evaluation, EvaluationState, Stage
from bo_tuner.tuning.driver import Driver
from bo_tuner.tuning.loop import Tuning

pytestmark = pytest.mark.ros

PAGE = Path(__file__).parents[3] / "docs" / "procedure.md"
PERIOD, STEPS = 0.01, 20
INERTIA, VISCOUS, DRY, MAX_TORQUE = 0.02, 0.05, 0.02, 1.0
WOUND_UP = 0.9
"""Torque [N m] that the integrator has when the tuner comes."""


class Motor(Node):
    """A motor with dry friction under a PID, in one node that works from its start on."""

    def __init__(self, context):
        super().__init__("pid", context=context)
        for name, value in (("kp", 0.5), ("ki", 0.5), ("kd", 0.05)):
            self.declare_parameter(name, value)
        self.speed = self.setpoint = 0.0
        # Where it rests under the gains that it has: dry friction holds the small rest.
        self.integral, self.angle = WOUND_UP, WOUND_UP / 0.5
        self.states = self.create_publisher(JointState, "joint_states", 10)
        self.create_subscription(Float64, "setpoint", self.follow, 10)
        self.create_service(Trigger, "~/reset", self.reset)
        self.create_timer(PERIOD, self.step)

    def follow(self, message):
        self.setpoint = message.data

    def reset(self, request, response):
        self.integral, response.success = 0.0, True
        return response

    def step(self):
        kp, ki, kd = (self.get_parameter(name).value for name in ("kp", "ki", "kd"))
        error = self.setpoint - self.angle
        wanted = kp * error + self.integral - kd * self.speed
        if abs(wanted) < MAX_TORQUE:
            self.integral += ki * PERIOD * error
        torque = min(max(wanted, -MAX_TORQUE), MAX_TORQUE)
        for _ in range(STEPS):
            self.move(torque, PERIOD / STEPS)
        message = JointState(name=["motor"], position=[self.angle], velocity=[self.speed])
        message.header.stamp = self.get_clock().now().to_msg()
        self.states.publish(message)

    def move(self, torque, h):
        """Friction opposes the motion, and holds what does not move."""
        speed = self.speed + h / INERTIA * (torque - VISCOUS * self.speed)
        slowed = h / INERTIA * DRY
        self.speed = 0.0 if abs(speed) <= slowed else speed - math.copysign(slowed, speed)
        self.angle += h * self.speed


def recipe():
    """Sections `park` and `run` of the page."""
    text = PAGE.read_text().partition("**A free-running machine**")[2]
    return yaml.safe_load(text.partition("```yaml\n")[2].partition("```")[0])


def study(**changes):
    node = {"node": "pid", "type": "double"}
    return study_from_mapping(
        signal_study(
            nodes={"pid": {"node": "pid"}},
            parameters={
                "kp": node | {"bounds": [0.1, 5.0], "default": 0.5},
                "ki": node | {"bounds": [0.0, 2.0], "default": 0.5},
                "kd": node | {"bounds": [0.01, 0.5], "default": 0.05},
            },
            signals={
                "angle": {"topic": "/joint_states", "field": "position[motor]"},
                "speed": {"topic": "/joint_states", "field": "velocity[motor]"},
            },
            metrics={"error": {"of": "1 - angle", "measure": "iae"}},
            budget={"trials": 9, "initial_trials": 4},
        )
        | recipe()
        | changes
    )


@pytest.fixture
def motor():
    """The motor, whose integrator was wound up before anybody came."""
    with at_work(Motor) as node:
        yield node


@pytest.fixture
def tuned(motor, tmp_path):
    """Function that makes and opens a backend for a study of the motor."""
    opened = []

    def make(made):
        opened.append(RosBackend(made, tmp_path, attach=True))
        opened[-1].open()
        return opened[-1]

    yield make
    for backend in opened:
        backend.close()


def evaluated(backend, **gains):
    parameters = {"kp": 2.0, "ki": 0.5, "kd": 0.2} | gains
    return backend.outcome(Evaluation(0, 0, Stage.DRAWN, parameters, {}, 1))


def test_the_recipe_brings_each_run_to_its_start(tuned, motor):
    backend = tuned(study())
    for gains in ({}, {"ki": 2.0}, {"kp": 0.3, "ki": 0.0}):
        outcome = evaluated(backend, **gains)
        assert outcome.state is EvaluationState.COMPLETE, outcome.reason


def test_a_machine_that_does_not_settle_is_no_disturbance(tuned, motor):
    """As without the step that empties the integrator: friction holds the machine where it is."""
    sections = recipe()
    settled = {"wait_until": {"condition": "abs(angle) < 0.1", "hold": 0.5, "timeout": 0.7}}
    sections["run"]["before"] = [sections["run"]["before"][0], settled]
    # It empties the integrator, too.
    del sections["run"]["recover"]
    motor.set_parameters([Parameter("ki", value=0.0)])
    made = study(**sections)
    tuning = Tuning(made, Driver(tuned(made)), METHODS["boundary"])
    with pytest.raises(RunError) as caught:
        list(tuning)
    assert [trial.ending for trial in tuning.trials] == ["unprepared"] * 3
    said = str(caught.value)
    assert said.startswith(
        "3 trials in a row could not be prepared: the preparation with the safe parameters failed: "
        "run.before[1]: 'abs(angle) < 0.1' does not hold for 0.5 s within 0.7 s (angle "
    )
    assert "; try a longer timeout, a wider condition, other gains in park, or to reset the" in said
