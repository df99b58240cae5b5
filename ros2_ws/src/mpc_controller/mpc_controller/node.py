"""The controller's ROS 2 node: a reference and measurements in, commands out.

It knows topics only, so that a drive with the same topics can stand in for the simulated axis.
"""

from dataclasses import asdict

# Ahead of rclpy and all messages: this package switches their field checks on.
from feed_axis_common.ros.messages import (
    LOOP_QOS,
    NANOSECONDS,
    VelocityPublisher,
    cut_result,
    from_stamp,
    is_time,
    read_joint_velocity,
    read_velocity_trajectory,
)

# isort: split
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import JointTrajectory

from feed_axis_common.errors import FeedAxisError
from feed_axis_common.ros.parameters import NodeParameters
from mpc_controller.controller import MpcController
from mpc_controller.settings import ControllerSettings, default_settings

PHASE_SHARE = 0.1
"""Share of a new measurement in the phase of the samples: it follows a clock that drifts."""
JITTER = 0.3
"""Largest distance of the first measurement from its sample [samples] that is taken for jitter."""
LONGEST_GAP = 200
"""Most measurements in a row that can be lost; one from further ahead is not of this cut."""


class ControllerNode(Node):
    """Kalman filter and MPC of one axis.

    A reference on ``~/joint_trajectory`` starts a cut: at its stamp, or with the next measurement
    if the stamp is zero. Each measurement of the cut on ``joint_states`` is answered once on
    ``~/command``; when it is repeated, so is the answer. ``~/cut_result`` sums up the cut.
    Parameters may change at any time and take effect with the next cut.
    """

    def __init__(self) -> None:
        super().__init__("mpc_controller", automatically_declare_parameters_from_overrides=True)
        self._controller = MpcController()
        self._parameter_table = NodeParameters(self, ControllerSettings, asdict(default_settings()))
        self._start: int | None = None
        self._running = False
        self._early: JointState | None = None
        self._ignored = 0
        self._command = VelocityPublisher(self, "~/command")
        self._estimate = VelocityPublisher(self, "~/estimated_state")
        self._result = self.create_publisher(DiagnosticArray, "~/cut_result", LOOP_QOS)
        self.create_subscription(
            JointTrajectory, "~/joint_trajectory", self._on_trajectory, LOOP_QOS
        )
        self.create_subscription(JointState, "joint_states", self._on_measurement, LOOP_QOS)

    def _on_trajectory(self, message: JointTrajectory) -> None:
        start = from_stamp(message.header.stamp)
        if start != 0 and start == self._start:
            return
        if not is_time(start):
            self._ignored += 1
            return
        settings = self._parameter_table.settings
        self._settings = settings
        self._controller.settings = settings
        self._start = start or None
        self._phase: float | None = None
        self._latest = start
        self._running = False
        self._ignored = 0
        try:
            self._controller.start(
                read_velocity_trajectory(message, settings.joint_name, settings.sample_time)
            )
        except FeedAxisError as error:
            self.get_logger().error(str(error))
            self._publish_result({"status": "failed", "reason": str(error)})
            return
        self._running = True
        # Topics have no order between them: the first measurement may have come before this.
        early, self._early = self._early, None
        if start and early is not None and self._sample(early) == 0:
            self._on_measurement(early)

    def _sample(self, measurement: JointState) -> int:
        """Index of the sample that a measurement belongs to."""
        time = from_stamp(measurement.header.stamp)
        if self._start is None:
            self._start = time
        return round(self._periods(time) - (self._phase or 0.0))

    def _periods(self, time: int) -> float:
        """Time since the start [samples]."""
        start = time if self._start is None else self._start
        return (time - start) / (self._settings.sample_time * NANOSECONDS)

    def _follow(self, time: int, k: int) -> None:
        """Note where between two samples of the reference a drive measures.

        Its clock may be another one: half a sample off, jitter alone would give two measurements
        one index, and the next none.
        """
        phase = self._periods(time) - k
        if self._phase is None:
            self._phase = phase if abs(phase) > JITTER else 0.0
        self._phase += PHASE_SHARE * (phase - self._phase)

    def _on_measurement(self, message: JointState) -> None:
        settings = self._settings if self._running else self._parameter_table.settings
        velocity = read_joint_velocity(message, settings.joint_name)
        if velocity is None:
            self._ignored += 1
            return
        if not self._running:
            self._early = message
            return
        controller = self._controller
        k = self._sample(message)
        farthest = controller.samples_done + LONGEST_GAP
        if not 0 <= k <= min(controller.reference_length - 1, farthest):
            self._ignored += 1
            self._early = message
            return
        if k < controller.samples_done:
            if k == controller.samples_done - 1:
                # A drive may measure more often, too.
                self._follow(from_stamp(message.header.stamp), k)
                self._command.repeat()
            else:
                self._early = message
            return
        while controller.samples_done < k:
            controller.skip()
        step = controller.step(velocity)
        time = from_stamp(message.header.stamp)
        self._follow(time, k)
        self._latest = time
        self._command.publish(settings.joint_name, time, step.command)
        if self._estimate.subscription_count > 0:
            self._estimate.publish(settings.joint_name, time, step.estimate)
        if controller.samples_done == controller.reference_length:
            self._publish_result(controller.cut_result() | {"ignored_messages": self._ignored})

    def _publish_result(self, result: dict[str, float | str]) -> None:
        self._result.publish(
            cut_result(
                self.get_name(),
                self._settings.joint_name,
                self._start or 0,
                self._latest,
                result,
            )
        )
