"""Nodes end with code 0 on any signal, once or twice, at their start, idle or in a cut."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from waiting import DEADLINE

pytestmark = pytest.mark.ros

INT, TERM = signal.SIGINT, signal.SIGTERM
PATTERNS = {
    "w0": (INT,),
    "w1": (TERM,),
    "w2": (INT, INT),
    "w3": (TERM, TERM),
    "w4": (INT, TERM),
}
PACKAGES = ("milling_plant", "mpc_controller")
# Each stands for a stage of the imports: settings, numerics, middleware, messages.
IMPORTS = ("yaml", "numpy", "rclpy", "builtin_interfaces", "trajectory_msgs")
# Stays in the import whatever is raised in it, as some libraries catch all that goes wrong there.
# It sleeps for moments: Python would see a signal just ahead of a long sleep only after it.
STUCK_IMPORT = """
import time
print("importing", flush=True)
while True:
    try:
        time.sleep(0.01)
    except BaseException:
        pass
"""
STUCK_START = """
import os
import signal
import sys
from feed_axis_common.ros.process import run
from rclpy.node import Node

class Start(Node):
    def __init__(self):
        for signum in (signal.SIGTERM, signal.SIGINT):
            os.kill(os.getpid(), signum)
        super().__init__("start")

sys.exit(run(Start, "", ()))
"""


STUCK_SPIN = """
import sys
import time
from feed_axis_common.ros import process
from rclpy.node import Node

class Executor:
    def add_node(self, node):
        pass

    def spin_once(self, timeout_sec):
        print("spinning", flush=True)
        # Like a call that does not return to the interpreter.
        while True:
            try:
                time.sleep(3600.0)
            except BaseException:
                pass

process.make_executor = Executor
process.EXIT_TIMEOUT = 0.2
sys.exit(process.run(lambda: Node("stuck"), "", ()))
"""
STUCK_DESTRUCTION = """
import ctypes
import os
import signal
import sys
import rclpy
from feed_axis_common.ros import process
from rclpy.node import Node

class Stuck(Node):
    def destroy_node(self):
        # It holds the interpreter's lock, as rclpy does in a call of the middleware.
        ctypes.PyDLL(None).sleep(3600)

class Executor:
    def add_node(self, node):
        pass

    def spin_once(self, timeout_sec):
        if end == "signal":
            os.kill(os.getpid(), signal.SIGTERM)
        else:
            rclpy.shutdown()
            raise RuntimeError("the context is shut down")

    def remove_node(self, node):
        pass

    def shutdown(self):
        pass

process.make_executor = Executor
# Long enough to come to the destruction on a busy machine.
process.EXIT_TIMEOUT = 2.0
end = sys.argv.pop()
sys.exit(process.run(lambda: Stuck("stuck"), "", ()))
"""


def start(start_node, keys):
    """Start nodes by (namespace, package)."""
    return {key: start_node(key[1], "-r", f"__ns:=/{key[0]}") for key in keys}


def end(nodes):
    """Signal all nodes, some twice, and expect that each ends well.

    The second signal follows at once, or when the node may be on its way out.
    """
    for (namespace, package), node in nodes.items():
        node.send(PATTERNS[namespace][0])
        if package == "mpc_controller":
            node.send(*PATTERNS[namespace][1:])
    time.sleep(0.1)
    for (namespace, package), node in nodes.items():
        if package == "milling_plant" and node.popen.poll() is None:
            node.send(*PATTERNS[namespace][1:])
    for key, node in nodes.items():
        assert node.wait() == 0, (key, node.output)
        assert "Traceback" not in node.output


@pytest.mark.parametrize("package", PACKAGES)
@pytest.mark.parametrize("module", IMPORTS)
def test_nodes_that_still_import(ros_environment, tmp_path, package, module):
    """The executable finds, instead of `module`, one whose import does not come to its end."""
    (tmp_path / f"{module}.py").write_text(STUCK_IMPORT)
    environment = os.environ | {"PYTHONPATH": str(tmp_path)}
    command = Path(sys.prefix) / "lib" / package / package
    for signals in PATTERNS.values():
        node = subprocess.Popen(
            [command], env=environment, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
        )
        try:
            assert node.stdout.readline() == "importing\n"
            for signum in signals:
                node.send_signal(signum)
            output, _ = node.communicate(timeout=DEADLINE)
        finally:
            node.kill()
            node.wait()
        assert (node.returncode, output) == (0, ""), signals


def test_a_node_that_is_being_made(ros_environment):
    done = subprocess.run(
        [sys.executable, "-c", STUCK_START], check=False, capture_output=True, text=True
    )
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")


@pytest.mark.parametrize("signum", [signal.SIGINT, signal.SIGTERM])
def test_a_node_whose_spin_does_not_return(ros_environment, signum):
    with subprocess.Popen([sys.executable, "-c", STUCK_SPIN], stdout=subprocess.PIPE) as node:
        try:
            assert node.stdout.readline() == b"spinning\n"
            node.send_signal(signum)
            assert node.wait(DEADLINE) == 0
        finally:
            node.kill()


@pytest.mark.parametrize(("end", "code"), [("signal", 0), ("fault", 1)])
def test_a_node_whose_destruction_does_not_return(ros_environment, end, code):
    done = subprocess.run(
        [sys.executable, "-c", STUCK_DESTRUCTION, end],
        check=False,
        capture_output=True,
        text=True,
        timeout=DEADLINE,
    )
    assert (done.returncode, done.stdout, done.stderr) == (code, "", "")


def test_idle_nodes(start_node, peer):
    keys = [(namespace, PACKAGES[i % 2]) for i, namespace in enumerate(PATTERNS)]
    nodes = start(start_node, keys)
    for namespace, package in nodes:
        peer.get_parameters(f"{namespace}/{package}", ["gain"])
    end(nodes)


def test_nodes_in_a_cut(start_node, peer):
    nodes = start(start_node, [(n, package) for n in PATTERNS for package in PACKAGES])
    for namespace in PATTERNS:
        plant = f"{namespace}/milling_plant"
        # A cut that neither ends nor is given up while the others are started.
        values = {"reference_levels": [0.5], "samples_per_level": 10_000, "command_timeout": 60.0}
        assert peer.set_parameters(plant, values).successful
    for namespace in PATTERNS:
        trigger = f"{namespace}/milling_plant/run_cut"
        peer.spin_until(lambda t=trigger: peer.trigger(t).success, "a cut to start")
    for namespace in PATTERNS:
        assert not peer.trigger(f"{namespace}/milling_plant/run_cut").success
    end(nodes)
