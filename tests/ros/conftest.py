"""Nodes as processes of their own, and a node of the test that talks to them.

Nothing here sleeps for a fixed time: whatever is waited for is polled with a deadline.
"""

import fcntl
import os
import signal
import socket
import subprocess
import sys
import tempfile
import time
from dataclasses import asdict
from pathlib import Path

import pytest
from waiting import DEADLINE

PROFILE = Path(__file__).parents[2] / "ros2_ws/src/bo_tuner/config/fastdds_profile.xml"
FIRST_PORT, PORTS_PER_DOMAIN = 7400, 250


def claim_domain(worker):
    """Take a free ROS domain for this process: (domain, lock to hold).

    Workers of pytest-xdist look in ranges of their own, from above, as the tuner starts from below.
    """
    index = int(worker.removeprefix("gw") or 0)
    for offset in range(101):
        domain = 1 + (100 - 10 * index - offset) % 101
        lock = (Path(tempfile.gettempdir()) / f"milling-tests-domain-{domain}.lock").open("w")
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
                probe.bind(("", FIRST_PORT + PORTS_PER_DOMAIN * domain + 10))
            except OSError:
                lock.close()
                continue
        return domain, lock
    raise RuntimeError("no free ROS domain")


@pytest.fixture(scope="module", autouse=True)
def ros_environment(tmp_path_factory):
    """This machine only, a domain of this worker, no shared memory, logs in a scratch folder.

    The discovery range LOCALHOST would make rmw_fastrtps choose its own transports, with shared
    memory and whatever the profile or FASTDDS_BUILTIN_TRANSPORTS say. So the profile does it all.
    """
    domain, lock = claim_domain(os.environ.get("PYTEST_XDIST_WORKER", "gw"))
    with pytest.MonkeyPatch.context() as patch, lock:
        patch.setenv("ROS_DOMAIN_ID", str(domain))
        patch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "SUBNET")
        patch.setenv("FASTDDS_BUILTIN_TRANSPORTS", "UDPv4")
        patch.setenv("FASTRTPS_DEFAULT_PROFILES_FILE", str(PROFILE))
        patch.setenv("ROS_LOG_DIR", str(tmp_path_factory.mktemp("log")))
        patch.setenv("RCUTILS_COLORIZED_OUTPUT", "0")
        patch.setenv("ROS_PYTHON_CHECK_FIELDS", "1")
        before = shared_memory_of(domain)
        yield
        assert shared_memory_of(domain) <= before


def shared_memory_of(domain):
    """Names of the shared-memory files that participants of a domain have made."""
    names = [path.name for path in Path("/dev/shm").glob("fastrtps_port*")]
    ports = {name: int("".join(c for c in name if c.isdigit())) for name in names}
    return {name for name, p in ports.items() if (p - FIRST_PORT) // PORTS_PER_DOMAIN == domain}


class NodeProcess:
    """A started node."""

    def __init__(self, package, arguments, log):
        self.log = log
        self.expected_code = 0
        command = [sys.executable, "-m", package]
        if arguments:
            command += ["--ros-args", *arguments]
        with log.open("w") as output:
            self.popen = subprocess.Popen(
                command, stdin=subprocess.DEVNULL, stdout=output, stderr=subprocess.STDOUT
            )

    @property
    def output(self):
        return self.log.read_text()

    def send(self, *signals):
        for signum in signals:
            self.popen.send_signal(signum)

    def wait(self, timeout=DEADLINE):
        return self.popen.wait(timeout)

    def kill(self):
        self.expected_code = -signal.SIGKILL
        self.popen.kill()
        self.wait()

    def end(self):
        """End the node as a user would; it must take it well."""
        if self.popen.poll() is None:
            self.send(signal.SIGTERM)
        try:
            code = self.wait()
        except subprocess.TimeoutExpired:
            self.kill()
            raise
        assert code == self.expected_code, self.output
        assert "Traceback" not in self.output, self.output


class Starter:
    """Starts nodes and ends all that still run."""

    def __init__(self, folder):
        self._folder = folder
        self._nodes = []

    def __call__(self, package, *arguments):
        log = self._folder / f"{package}-{len(self._nodes)}.txt"
        self._nodes.append(NodeProcess(package, arguments, log))
        return self._nodes[-1]

    def end(self):
        errors = []
        for node in self._nodes:
            if node.popen.poll() is None:
                node.send(signal.SIGTERM)
        for node in self._nodes:
            try:
                node.end()
            except (AssertionError, subprocess.TimeoutExpired) as error:
                errors.append(error)
        if errors:
            raise errors[0]


@pytest.fixture
def start_node(tmp_path, ros_environment):
    """Function that starts a node: package, then ROS arguments."""
    starter = Starter(tmp_path)
    yield starter
    starter.end()


@pytest.fixture(scope="module")
def start_shared_node(tmp_path_factory, ros_environment):
    """The same for nodes that the tests of a module share."""
    starter = Starter(tmp_path_factory.mktemp("nodes"))
    yield starter
    starter.end()


class Peer:
    """A node of the test with its own context and executor."""

    def __init__(self, namespace=""):
        import rclpy
        from rclpy.executors import SingleThreadedExecutor

        self.context = rclpy.Context()
        rclpy.init(args=[], context=self.context)
        self.node = rclpy.create_node("peer", namespace=namespace, context=self.context)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        self._clients = {}

    def close(self):
        self.executor.shutdown()
        self.node.destroy_node()
        self.context.try_shutdown()

    def spin_until(self, condition, what, timeout=DEADLINE):
        """Handle what comes until the condition holds."""
        assert self._spin(condition, timeout), f"waited {timeout} s for {what}"

    def _spin(self, condition, timeout):
        end = time.monotonic() + timeout
        while not condition():
            if time.monotonic() > end:
                return False
            self.executor.spin_once(timeout_sec=0.02)
        return True

    def spin_for(self, duration):
        """Handle what comes for a while, to see that something does not come."""
        self._spin(lambda: False, duration)

    def call(self, service, name, request):
        """Call a service and return its answer.

        A server may take a request before it has discovered where the answer goes, which is then
        lost: what stays unanswered is asked again.
        """
        if name not in self._clients:
            self._clients[name] = self.node.create_client(service, name)
        client = self._clients[name]
        self.spin_until(client.service_is_ready, f"service {name}")
        futures = []
        while len(futures) < 20:
            futures.append(client.call_async(request))
            # A late answer to an earlier request is as good.
            if self._spin(lambda: any(f.done() for f in futures), DEADLINE / 60):
                answered = next(f for f in futures if f.done())
                for future in futures:
                    client.remove_pending_request(future)
                return answered.result()
        raise AssertionError(f"no answer of {name}")

    def trigger(self, name):
        from std_srvs.srv import Trigger

        return self.call(Trigger, name, Trigger.Request())

    def record(self, message, topic):
        """List that fills with the messages of a topic."""
        received = []
        # Deep, so that a test that is busy elsewhere loses nothing.
        self.node.create_subscription(message, topic, received.append, 10_000)
        return received

    def meet(self, node):
        """Wait until a node sends here whatever this one has subscribed to so far.

        It hears of the ends of this node in the order of their making. So one that answers a new
        client knows all earlier subscriptions; that publishers are seen here does not tell.
        """
        client = self._clients.pop(f"{node}/get_parameters", None)
        if client is not None:
            self.node.destroy_client(client)
        self.get_parameters(node, ["use_sim_time"])

    def set_parameters(self, node, values):
        """Set parameters atomically; returns the result message."""
        from rcl_interfaces.srv import SetParametersAtomically
        from rclpy.parameter import Parameter

        parameters = [
            Parameter(name, value=value).to_parameter_msg() for name, value in values.items()
        ]
        request = SetParametersAtomically.Request(parameters=parameters)
        return self.call(
            SetParametersAtomically, f"{node}/set_parameters_atomically", request
        ).result

    def get_parameters(self, node, names):
        from rcl_interfaces.srv import GetParameters
        from rclpy.parameter import parameter_value_to_python

        answer = self.call(
            GetParameters, f"{node}/get_parameters", GetParameters.Request(names=list(names))
        )
        return [parameter_value_to_python(value) for value in answer.values]


@pytest.fixture
def make_peer(ros_environment):
    """Function that makes a `Peer` in a namespace."""
    peers = []

    def make(namespace=""):
        peers.append(Peer(namespace))
        return peers[-1]

    yield make
    for peer in peers:
        peer.close()


@pytest.fixture
def peer(make_peer):
    return make_peer()


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


@pytest.fixture(scope="module")
def shared_pair(start_shared_node):
    """Plant and controller as processes, for all tests of a module."""
    return [start_shared_node(package) for package in ("milling_plant", "mpc_controller")]


@pytest.fixture
def client(shared_pair, peer):
    """The test's node, with the shared pair at its shipped parameters."""
    reset_parameters(peer)
    return peer


@pytest.fixture
def loop(client):
    """The shared pair at its shipped parameters, seen by the test."""
    loop = Loop(client)
    loop.connect()
    return loop


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


@pytest.fixture(scope="module")
def shared_plant(start_shared_node):
    """A plant as a process, for all tests of a module."""
    return start_shared_node("milling_plant")


@pytest.fixture
def stand_in_controller(shared_plant, peer):
    """Function that sets parameters of the shared plant and takes the controller's place."""

    def make(answer=None, **parameters):
        reset_parameters(peer, ["milling_plant"])
        assert peer.set_parameters("milling_plant", parameters).successful
        return StandInController(peer, answer)

    return make


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
        """Send references that are refused until the refusal arrives here."""

        def refused():
            # Never a stamp for the second time: what is refused once is not answered again.
            self.reference([float("nan")], start=time.time_ns())
            self.peer.spin_for(0.1)
            return bool(self.results)

        self.peer.spin_until(refused, "the controller's result")
        self.peer.spin_for(0.1)
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

    def result(self):
        """Wait for one result; its values, level and message."""
        self.peer.spin_until(lambda: bool(self.results), "the controller's result")
        message = self.results.pop(0)
        return values_of(message), message.status[0].level, message.status[0].message


def duration(nanoseconds):
    from builtin_interfaces.msg import Duration

    return Duration(sec=nanoseconds // 10**9, nanosec=nanoseconds % 10**9)


@pytest.fixture(scope="module")
def shared_controller(start_shared_node):
    """A controller as a process, for all tests of a module."""
    return start_shared_node("mpc_controller")


@pytest.fixture
def drive(shared_controller, peer):
    """A drive of the test for the shared controller."""
    return Drive(peer)


@pytest.fixture
def make_loop():
    """Function that looks at running nodes from a peer."""
    return Loop
