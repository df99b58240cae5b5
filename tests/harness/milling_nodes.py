"""Plant and controller as seen from a test, and nodes of the test in the place of either."""

import time
from dataclasses import asdict

from waiting import DEADLINE


def reset_parameters(peer, nodes=("milling_plant", "mpc_controller")):
    """Set all parameters of both nodes to the shipped values."""
    import milling_plant.settings
    import mpc_controller.settings

    modules = {"milling_plant": milling_plant.settings, "mpc_controller": mpc_controller.settings}
    for node in nodes:
        values = {
            name: list(value) if isinstance(value, tuple) else value
            for name, value in asdict(modules[node].default_settings()).items()
        }
        result = peer.set_parameters(node, values)
        assert result.successful, result.reason


def values_of(result):
    """Key-value pairs of a cut_result message."""
    (status,) = result.status
    return {item.key: item.value for item in status.values}


class Loop:
    """Plant and controller processes as seen from a test: parameters, cuts and their results."""

    def __init__(self, peer):
        from diagnostic_msgs.msg import DiagnosticArray
        from sensor_msgs.msg import JointState
        from trajectory_msgs.msg import JointTrajectory

        self.peer = peer
        self.references = peer.record(JointTrajectory, "mpc_controller/joint_trajectory")
        self.measurements = peer.record(JointState, "joint_states")
        self.commands = peer.record(JointState, "mpc_controller/command")
        self._results = {
            node: peer.record(DiagnosticArray, f"{node}/cut_result")
            for node in ("milling_plant", "mpc_controller")
        }

    def set(self, node, **values):
        """Set parameters and expect that they are taken."""
        result = self.peer.set_parameters(node, values)
        assert result.successful, result.reason

    def clear(self):
        for received in (self.references, self.measurements, self.commands):
            received.clear()
        for received in self._results.values():
            received.clear()

    def start_cut(self):
        """Start a cut, as soon as the plant takes it; returns its identifier."""
        answers = []

        def started():
            answers.append(self.peer.trigger("milling_plant/run_cut"))
            return answers[-1].success

        self.peer.spin_until(started, "a cut to start")
        return answers[-1].message

    def has_result(self, node, cut):
        return any(values_of(message)["cut"] == cut for message in self._results[node])

    def result(self, node, cut, timeout=DEADLINE):
        """Message with the result of a cut."""
        self.peer.spin_until(
            lambda: self.has_result(node, cut), f"result of {cut} from {node}", timeout
        )
        (message,) = [m for m in self._results[node] if values_of(m)["cut"] == cut]
        return message

    def run_cut(self):
        """Run a cut to its end: values of the plant's and of the controller's result."""
        cut = self.start_cut()
        plant = values_of(self.result("milling_plant", cut))
        return plant, values_of(self.result("mpc_controller", cut))

    def connect(self):
        """Run short cuts until this test sees all that passes between the nodes."""
        (levels, samples) = self.peer.get_parameters(
            "milling_plant", ("reference_levels", "samples_per_level")
        )
        self.set("milling_plant", reference_levels=[0.5], samples_per_level=2)

        def connected():
            self.clear()
            cut = self.start_cut()
            self.peer.spin_for(0.1)
            seen = (self.references, self.measurements[1:], self.commands[1:])
            return all(seen) and all(self.has_result(node, cut) for node in self._results)

        self.peer.spin_until(connected, "all topics of the loop")
        self.set("milling_plant", reference_levels=list(levels), samples_per_level=samples)
        self.clear()


class StandInController:
    """A node of the test in the controller's place; `answer` gets each measurement.

    It returns the commands to publish, as (stamp of the measurement, velocity) pairs.
    """

    def __init__(self, peer, answer=None):
        from diagnostic_msgs.msg import DiagnosticArray
        from sensor_msgs.msg import JointState
        from trajectory_msgs.msg import JointTrajectory

        self.peer = peer
        self.measurements = []
        self.answer = answer or (lambda message: [(message.header.stamp, 0.5)])
        self.references = peer.record(JointTrajectory, "mpc_controller/joint_trajectory")
        self.results = peer.record(DiagnosticArray, "milling_plant/cut_result")
        self.command = peer.node.create_publisher(JointState, "mpc_controller/command", 10)
        peer.node.create_subscription(JointState, "joint_states", self._on_measurement, 10)
        peer.spin_until(lambda: self.command.get_subscription_count() > 0, "the plant")
        peer.meet("milling_plant")

    def _on_measurement(self, message):
        self.measurements.append(message)
        for stamp, velocity in self.answer(message):
            self.publish(stamp, velocity)

    def publish(self, stamp, velocity, joint="x_axis"):
        from sensor_msgs.msg import JointState
        from std_msgs.msg import Header

        self.command.publish(
            JointState(header=Header(stamp=stamp), name=[joint], velocity=[float(velocity)])
        )

    def run_cut(self):
        """Start a cut and return the values of its result and the message's level."""
        cut = Loop.start_cut(self)
        self.peer.spin_until(
            lambda: any(values_of(m)["cut"] == cut for m in self.results), "the result"
        )
        (message,) = [m for m in self.results if values_of(m)["cut"] == cut]
        return values_of(message), message.status[0].level


class Drive:
    """A node of the test in the plant's place, with topics as of a real drive."""

    def __init__(self, peer):
        from diagnostic_msgs.msg import DiagnosticArray
        from sensor_msgs.msg import JointState
        from trajectory_msgs.msg import JointTrajectory

        self.peer = peer
        self.commands = peer.record(JointState, "mpc_controller/command")
        self.results = peer.record(DiagnosticArray, "mpc_controller/cut_result")
        self._reference = peer.node.create_publisher(
            JointTrajectory, "mpc_controller/joint_trajectory", 10
        )
        self._state = peer.node.create_publisher(JointState, "joint_states", 10)
        peer.spin_until(
            lambda: (
                self._reference.get_subscription_count() > 0
                and self._state.get_subscription_count() > 0
            ),
            "the controller",
        )
        self._connect()

    def _connect(self):
        """Send references that are refused until the refusal of the last one arrives here."""
        from feed_axis_common.ros.messages import to_stamp

        sent = []

        def refused():
            # Never a stamp for the second time: what is refused once is not answered again.
            sent.append(time.time_ns())
            self.reference([float("nan")], start=sent[-1])
            self.peer.spin_for(0.1)
            return bool(self.results)

        self.peer.spin_until(refused, "the controller's result")
        # Those sent before the first refusal came are answered, too, on a busy machine much later.
        last = to_stamp(sent[-1])
        self.peer.spin_until(
            lambda: any(result.header.stamp == last for result in self.results),
            "the refusal of the last reference",
        )
        self.results.clear()

    def reference(self, velocities, start, spacing=0.02, joints=("x_axis",), rows=None):
        """Publish a reference; `rows` are the points' velocities if they are not for one joint."""
        from std_msgs.msg import Header
        from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

        from feed_axis_common.ros.messages import to_stamp

        rows = [[float(v)] for v in velocities] if rows is None else rows
        self._reference.publish(
            JointTrajectory(
                header=Header(stamp=to_stamp(start)),
                joint_names=list(joints),
                points=[
                    JointTrajectoryPoint(
                        velocities=row, time_from_start=duration(round(k * spacing * 1e9))
                    )
                    for k, row in enumerate(rows)
                ],
            )
        )

    def deliver(self):
        """Wait until the controller has the references, ahead of measurements that follow.

        For those without a stamp, and where messages are counted: the first measurement of a
        stamped one is answered whichever comes first. It may take as long as a heartbeat.
        """
        from rclpy.duration import Duration

        assert self._reference.wait_for_all_acked(Duration(seconds=DEADLINE))

    def state(self, time_ns, velocities, joints=("x_axis",)):
        """Publish the joints' velocities."""
        from sensor_msgs.msg import JointState
        from std_msgs.msg import Header

        from feed_axis_common.ros.messages import to_stamp

        self._state.publish(
            JointState(
                header=Header(stamp=to_stamp(time_ns)),
                name=list(joints),
                velocity=[float(v) for v in velocities],
            )
        )

    def command_for(self, time_ns):
        """Wait for the first command with a stamp and return its velocity."""
        from feed_axis_common.ros.messages import from_stamp

        def answers():
            return [m for m in self.commands if from_stamp(m.header.stamp) == time_ns]

        self.peer.spin_until(answers, f"the command for {time_ns}")
        return answers()[0].velocity[0]

    def result(self, start=None):
        """Wait for one result, of the cut with a start if one is named; values, level, message.

        A reference of a test before, which was refused, has a result, too, and it may come late.
        """
        from feed_axis_common.ros.messages import cut_identifier

        def found():
            cut = None if start is None else cut_identifier(start)
            return [m for m in self.results if cut is None or values_of(m)["cut"] == cut]

        self.peer.spin_until(found, "the controller's result")
        message = found()[0]
        self.results.remove(message)
        return values_of(message), message.status[0].level, message.status[0].message


def duration(nanoseconds):
    from builtin_interfaces.msg import Duration

    return Duration(sec=nanoseconds // 10**9, nanosec=nanoseconds % 10**9)
