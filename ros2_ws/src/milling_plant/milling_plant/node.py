"""The plant's ROS 2 node: cuts in lock-step with a controller, faster than real time."""

from dataclasses import asdict, replace
from time import monotonic_ns, time_ns

# Ahead of rclpy and all messages: this package switches their field checks on.
from feed_axis_common.ros.messages import (
    LOOP_QOS,
    NANOSECONDS,
    VelocityPublisher,
    cut_identifier,
    cut_result,
    from_stamp,
    is_time,
    read_joint_velocity,
    to_stamp,
    velocity_trajectory,
)

# isort: split
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger
from trajectory_msgs.msg import JointTrajectory

from feed_axis_common.ros.parameters import NodeParameters
from milling_plant.cut import Cut
from milling_plant.settings import PlantSettings, default_settings


class PlantNode(Node):
    """The simulated feed axis.

    ``~/run_cut`` starts a cut and answers with its identifier. The plant publishes the reference,
    then measurement k on ``joint_states``, and steps once the command with the same stamp has
    come; an unanswered measurement is sent again. ``~/cut_result`` carries the metrics.
    ``~/abort`` ends a cut as failed. Parameters may change at any time and take effect with the
    next cut.
    """

    def __init__(self) -> None:
        super().__init__("milling_plant", automatically_declare_parameters_from_overrides=True)
        self._parameter_table = NodeParameters(self, PlantSettings, asdict(default_settings()))
        self._settings = self._parameter_table.settings
        self._cut: Cut | None = None
        self._start = 0
        self._lacks_clock = False
        self._next_start = 1  # a reference stamped zero would start with any measurement
        self._ignored = 0
        self._resent = 0
        self._trajectory: JointTrajectory | None = None
        self._trajectory_of: PlantSettings | None = None
        self._measurement = VelocityPublisher(self, "joint_states")
        self._reference = self.create_publisher(
            JointTrajectory, "mpc_controller/joint_trajectory", LOOP_QOS
        )
        self._result = self.create_publisher(DiagnosticArray, "~/cut_result", LOOP_QOS)
        self.create_subscription(JointState, "mpc_controller/command", self._on_command, LOOP_QOS)
        self.create_service(Trigger, "~/run_cut", self._on_run_cut)
        self.create_service(Trigger, "~/abort", self._on_abort)
        # Wall time, as simulated time stands still while the plant waits.
        self._wall = Clock(clock_type=ClockType.STEADY_TIME)
        self._watchdog = self.create_timer(
            _watchdog_period(self._settings), self._on_watchdog, clock=self._wall
        )

    def _on_run_cut(
        self, _request: Trigger.Request, response: Trigger.Response
    ) -> Trigger.Response:
        settings = self._parameter_table.settings
        start = self._next_time()
        samples = len(settings.reference_levels) * settings.samples_per_level
        response.success = False
        if self._running is not None:
            cut = cut_identifier(self._start)
            response.message = f"cut {cut} is still running; wait until it ends, or abort it"
        elif self._reference.get_subscription_count() == 0:
            response.message = f"no controller subscribes to {self._reference.topic_name}"
        elif not is_time(start + round(samples * settings.sample_time * NANOSECONDS)):
            response.message = "the cut would end after 2038, the end of ROS time stamps"
        else:
            self._begin(settings, start)
            response.success = True
            response.message = cut_identifier(self._start)
        return response

    def _next_time(self) -> int:
        """Time [ns] at which the next cut may start."""
        now = self.get_clock().now().nanoseconds
        if not now and not self._start:
            # Simulated time that nobody publishes: a plant that is started anew would repeat its
            # identifiers.
            now, self._lacks_clock = time_ns(), True
        elif now and self._lacks_clock and self._running is None:
            # The time of the machine is none to go on from.
            self._next_start, self._lacks_clock = 1, False
        return max(now, self._next_start)

    def _on_abort(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        cut = self._running
        response.success = cut is not None
        response.message = "no cut is running"
        if cut is not None:
            response.message = f"aborted cut {cut_identifier(self._start)}"
            cut.fail(f"aborted at sample {cut.sample}")
            self._end(cut)
        return response

    @property
    def _running(self) -> Cut | None:
        """The cut that waits for a command."""
        return None if self._cut is None or self._cut.done else self._cut

    def _begin(self, settings: PlantSettings, start: int) -> None:
        self._settings = settings
        self._watchdog.timer_period_ns = int(_watchdog_period(self._settings) * NANOSECONDS)
        # It would end its present period first, which may be a long one.
        self._watchdog.reset()
        self._cut = Cut(self._settings)
        self._start = start
        self._ignored = 0
        self._resent = 0
        self._publish_reference(self._cut)
        self._publish_measurement(self._cut)
        self._progress = monotonic_ns()

    def _publish_reference(self, cut: Cut) -> None:
        # Made again only if more than context and noise has changed: it has hundreds of points.
        s = self._settings
        shape = replace(s, stiffness_factor=1.0, damping_factor=1.0, seed=0)
        if self._trajectory is None or shape != self._trajectory_of:
            self._trajectory = velocity_trajectory(
                s.joint_name, self._start, cut.reference, s.sample_time
            )
            self._trajectory_of = shape
        self._trajectory.header.stamp = to_stamp(self._start)
        self._reference.publish(self._trajectory)

    def _time(self, sample: int) -> int:
        """Return the simulated time of a sample [ns]."""
        return self._start + round(sample * self._settings.sample_time * NANOSECONDS)

    def _publish_measurement(self, cut: Cut) -> None:
        self._measurement.publish(
            self._settings.joint_name, self._time(cut.sample), cut.measurement
        )

    def _on_command(self, message: JointState) -> None:
        cut, time = self._cut, from_stamp(message.header.stamp)
        command = read_joint_velocity(message, self._settings.joint_name)
        if cut is None or command is None:
            self._ignored += 1
            return
        if cut.done or time != self._time(cut.sample):
            self._ignored += 1
            self._compare(cut, time, command)
            return
        cut.apply(command)
        self._progress = monotonic_ns()
        if cut.done:
            self._end(cut)
        else:
            self._publish_measurement(cut)

    def _compare(self, cut: Cut, time: int, command: float) -> None:
        """Compare a command that comes too late with the one that was taken."""
        sample = round((time - self._start) / (self._settings.sample_time * NANOSECONDS))
        if time == self._time(sample) and cut.contradicted(sample, command):
            self._end(cut)

    def _on_watchdog(self) -> None:
        cut = self._running
        if cut is None:
            return
        silence = (monotonic_ns() - self._progress) / NANOSECONDS
        if silence > self._settings.command_timeout:
            cut.fail(
                f"no command for sample {cut.sample} within {self._settings.command_timeout} s"
            )
            self._end(cut)
        elif silence >= 0.5 * self._settings.resend_period:
            self._resent += 1
            if cut.sample == 0:
                self._publish_reference(cut)
            self._publish_measurement(cut)

    def _end(self, cut: Cut) -> None:
        # Cuts are faster than real time, but their stamps must not overlap: after a failed one
        # the controller still waits for the rest, and a recording holds all cuts in one sequence.
        self._next_start = self._time(cut.reference.size)
        counts = {"ignored_messages": self._ignored, "resent_measurements": self._resent}
        self._result.publish(
            cut_result(
                self.get_name(),
                self._settings.joint_name,
                self._start,
                self._time(cut.sample),
                cut.result() | counts,
            )
        )


def _watchdog_period(settings: PlantSettings) -> float:
    return min(settings.resend_period, settings.command_timeout)
