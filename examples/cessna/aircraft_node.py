"""A Cessna 172 under JSBSim's autopilot as a ROS 2 node that flies by itself, at the wall's pace.

A timer drives the simulation: at each tick it flies on to where the wall clock is, `rate` times as
fast. Nobody is waited for: a set-point acts when it comes. In simulated time, the node publishes

- /clock at each tick;
- /position ten times a second: z is the height above ground [m], the rest is zero;
- /rpy with each: roll (to the right), pitch (up) and heading (clockwise from north) [rad];
- /control_surfaces with each: the autopilot's commands to aileron and elevator, from -1 to 1.

It listens to /altitude_setpoint [m above ground] and /heading_setpoint [rad]. The gains of the
autopilot are parameters, and act at once; so is what a flight meets, which holds from the next
~/reset on: that starts a flight, in level flight, with altitude and heading held.
"""

import math
import signal
import time
from collections.abc import Iterable

import rclpy
from aircraft import GAINS, START_ALTITUDE, START_HEADING, Aircraft, Conditions, default_gains
from builtin_interfaces.msg import Time as TimeMessage
from geometry_msgs.msg import PointStamped, Vector3Stamped
from rcl_interfaces.msg import ParameterDescriptor, SetParametersResult
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.signals import SignalHandlerOptions
from rclpy.time import Time
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64
from std_srvs.srv import Trigger

TICK = 0.01  # of the timer, by the wall [s]
PUBLISHING_PERIOD = 0.1  # in simulated time [s]
LONGEST_DELAY = 0.1  # by the wall: what a busy computer falls behind further is not made up [s]
CONDITIONS = {
    "wind": "at a height of 20 ft [m/s]: the turbulence has a tenth of it",
    "airspeed": "calibrated, at the start [m/s]",
    "luggage": "in the baggage compartment [kg]",
    "wing_load": "under the right wing [kg]",
    "seed": "of the turbulence",
}


class AircraftNode(Node):
    """Flies on at each tick of its timer."""

    def __init__(self) -> None:
        super().__init__("cessna")
        # Before the declarations, so that it judges the values of a parameter file, too.
        self.add_on_set_parameters_callback(self._judge)
        self._declare("rate", 1.0, "simulated time over that of the wall")
        for name, text in CONDITIONS.items():
            self._declare(name, getattr(Conditions(), name), text)
        for name, value in default_gains().items():
            self._declare(name, value, GAINS[name].text)
        self.add_post_set_parameters_callback(self._apply)
        self._clock_publisher = self.create_publisher(Clock, "/clock", 10)
        self._position = self.create_publisher(PointStamped, "position", 10)
        self._attitude = self.create_publisher(Vector3Stamped, "rpy", 10)
        self._surfaces = self.create_publisher(JointState, "control_surfaces", 10)
        self.create_subscription(Float64, "altitude_setpoint", self._on_altitude, 10)
        self.create_subscription(Float64, "heading_setpoint", self._on_heading, 10)
        self.create_service(Trigger, "~/reset", self._on_reset)
        self._aircraft: Aircraft | None = None
        self._elapsed = 0.0  # simulated time of the flights before this one [s]
        self._reset()
        self.create_timer(TICK, self._fly)

    def _declare(self, name: str, value: float, text: str) -> None:
        self.declare_parameter(name, value, ParameterDescriptor(description=text))

    def _values(self, names: Iterable[str]) -> dict[str, float]:
        return {name: self.get_parameter(name).value for name in names}

    def _reset(self) -> None:
        aircraft = Aircraft(Conditions(**self._values(CONDITIONS)), self._values(GAINS))
        if self._aircraft is not None:
            self._elapsed += self._aircraft.time  # /clock never jumps back
        self._aircraft = aircraft
        self._setpoint = [START_ALTITUDE, START_HEADING]
        self._due = self._next = 0.0  # where the flight should be, and its next message [s]
        self._wall = time.monotonic()

    def _on_reset(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        try:
            self._reset()
            response.success = True
        except ValueError as error:
            response.message = str(error)
        return response

    def _judge(self, parameters: list[Parameter]) -> SetParametersResult:
        for item in parameters:
            if item.name in GAINS and not (math.isfinite(item.value) and item.value >= 0.0):
                reason = f"{item.name}: expected a number of at least 0, found {item.value:g}"
                return SetParametersResult(successful=False, reason=reason)
            if item.name == "rate" and not 0.0 < item.value <= 50.0:
                reason = f"rate: expected a number above 0, at most 50, found {item.value:g}"
                return SetParametersResult(successful=False, reason=reason)
        return SetParametersResult(successful=True)

    def _apply(self, parameters: list[Parameter]) -> None:
        self._aircraft.set_gains(
            {item.name: item.value for item in parameters if item.name in GAINS}
        )

    def _on_altitude(self, message: Float64) -> None:
        self._setpoint[0] = message.data
        self._aircraft.hold(*self._setpoint)

    def _on_heading(self, message: Float64) -> None:
        self._setpoint[1] = message.data
        self._aircraft.hold(*self._setpoint)

    def _fly(self) -> None:
        now = time.monotonic()
        rate = self.get_parameter("rate").value
        self._due += rate * min(now - self._wall, LONGEST_DELAY)
        self._wall = now
        while self._aircraft.time < self._due:
            self._aircraft.step()
            if self._aircraft.time >= self._next:
                self._next += PUBLISHING_PERIOD
                self._publish()
        self._clock_publisher.publish(Clock(clock=self._stamp()))

    def _stamp(self) -> TimeMessage:
        return Time(nanoseconds=round((self._elapsed + self._aircraft.time) * 1e9)).to_msg()

    def _publish(self) -> None:
        seen, stamp = self._aircraft.measure(), self._stamp()
        position, attitude = PointStamped(), Vector3Stamped()
        surfaces = JointState(name=["aileron", "elevator"])
        for message in (position, attitude, surfaces):
            message.header.stamp = stamp
        position.header.frame_id = attitude.header.frame_id = "world"
        position.point.z = seen["altitude"]
        vector = attitude.vector
        vector.x, vector.y, vector.z = seen["bank"], seen["pitch"], seen["heading"]
        surfaces.position = [seen["aileron"], seen["elevator"]]
        self._position.publish(position)
        self._attitude.publish(attitude)
        self._surfaces.publish(surfaces)


def main() -> None:
    """Run the node until Ctrl-C or SIGTERM."""
    signals: list[int] = []
    for signum in (signal.SIGINT, signal.SIGTERM):
        signal.signal(signum, lambda signum, _frame: signals.append(signum))
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    node = AircraftNode()
    node.get_logger().info("ready")
    while not signals:
        rclpy.spin_once(node, timeout_sec=0.1)
    node.destroy_node()
    rclpy.try_shutdown()


if __name__ == "__main__":
    main()
