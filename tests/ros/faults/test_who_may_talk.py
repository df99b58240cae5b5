"""Who hears our nodes: this machine only, unless told otherwise; and DDS security, which is not."""

import contextlib
import json
import os
import subprocess
import sys
import time
from pathlib import Path

import pytest
from waiting import DEADLINE

from bo_tuner.backends.ros.isolation import PROFILE_VARIABLES, isolated_environment

pytestmark = [pytest.mark.ros, pytest.mark.slow]

OTHER_MACHINE = """\
import json
import sys
import time

import rclpy

rclpy.init()
node = rclpy.create_node("other_machine")
awaited, seconds = sys.argv[1], float(sys.argv[2])
end = time.monotonic() + seconds
found = set()
while time.monotonic() < end and awaited not in found:
    rclpy.spin_once(node, timeout_sec=0.1)
    found = set(node.get_node_names())
print(json.dumps(sorted(found)))
"""
# What the test and the nodes' own environment have chosen for the network.
NETWORK = (
    "ROS_AUTOMATIC_DISCOVERY_RANGE",
    "FASTDDS_BUILTIN_TRANSPORTS",
    *PROFILE_VARIABLES,
)


def ip(*arguments):
    subprocess.run(["ip", *arguments], check=True, capture_output=True)


def wait_for_namespace(holder):
    """Wait until a process is in a network namespace of its own."""
    ours = Path("/proc/self/ns/net").readlink()
    end = time.monotonic() + DEADLINE
    while Path(f"/proc/{holder.pid}/ns/net").readlink() == ours:
        if holder.poll() is not None or time.monotonic() > end:
            raise OSError("unshare failed")
        time.sleep(0.01)


@pytest.fixture(scope="module")
def machine(ros_environment):
    """A network namespace, linked to ours as another machine would be; the way to start in it."""
    if os.geteuid() != 0:
        pytest.skip("network namespaces can be made by root only")
    # The domain is ours alone on this machine, so that the network is, too.
    domain = os.environ["ROS_DOMAIN_ID"]
    link = f"ours{domain}"
    addresses = [f"10.213.{domain}.{host}/24" for host in (1, 2)]
    holder = subprocess.Popen(["unshare", "--net", "sleep", "600"], stderr=subprocess.DEVNULL)
    try:
        wait_for_namespace(holder)
        ip("link", "add", link, "type", "veth", "peer", "name", "theirs", "netns", str(holder.pid))
        inside = ("nsenter", "--target", str(holder.pid), "--net")
        ip("address", "add", addresses[0], "dev", link)
        ip("link", "set", link, "up")
        for command in (
            ("address", "add", addresses[1], "dev", "theirs"),
            ("link", "set", "theirs", "up"),
            ("link", "set", "lo", "up"),
        ):
            subprocess.run([*inside, "ip", *command], check=True, capture_output=True)
    except (OSError, subprocess.CalledProcessError) as error:
        holder.kill()
        holder.wait()
        pytest.skip(f"no network namespace can be made here: {error}")
    yield inside
    with contextlib.suppress(subprocess.CalledProcessError):
        ip("link", "delete", link)
    holder.kill()
    holder.wait()


def seen_from(machine, awaited):
    """Nodes that one on the other machine, open to the network, knows once it sees the awaited."""
    environment = {k: v for k, v in os.environ.items() if k not in NETWORK}
    environment |= {
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET",
        # As between machines: nothing goes through a memory that both see.
        "FASTDDS_BUILTIN_TRANSPORTS": "UDPv4",
    }
    done = subprocess.run(
        [*machine, sys.executable, "-c", OTHER_MACHINE, awaited, str(DEADLINE / 2)],
        env=environment,
        capture_output=True,
        text=True,
        timeout=DEADLINE,
    )
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert awaited in found
    return found


class TestNetwork:
    def test_only_nodes_that_are_open_to_the_network_are_seen(
        self, machine, start_node, peer, monkeypatch
    ):
        """The plant, started as the tuner starts it, is there before the open controller."""
        with monkeypatch.context() as isolated:
            for name in NETWORK:
                isolated.delenv(name, raising=False)
            for name, value in isolated_environment(int(os.environ["ROS_DOMAIN_ID"])).items():
                isolated.setenv(name, value)
            start_node("milling_plant")
            peer.get_parameters("milling_plant", ["gain"])
        for name in PROFILE_VARIABLES:
            monkeypatch.delenv(name, raising=False)
        start_node("mpc_controller")
        assert "milling_plant" not in seen_from(machine, "mpc_controller")

    def test_the_plant_is_seen_if_it_is_open(self, machine, start_node, monkeypatch):
        for name in PROFILE_VARIABLES:
            monkeypatch.delenv(name, raising=False)
        start_node("milling_plant")
        seen_from(machine, "milling_plant")


class TestSecurity:
    """The Fast DDS of the wheels is built without it: what asks for it must not run without."""

    @pytest.fixture
    def keystore(self, tmp_path):
        (tmp_path / "keystore" / "enclaves" / "axis").mkdir(parents=True)
        return tmp_path / "keystore"

    @pytest.fixture
    def refusal(self, start_node, monkeypatch, keystore):
        """Function that starts a secured node, which does not start, and returns why."""

        def reason(package, enclave, strategy):
            monkeypatch.setenv("ROS_SECURITY_ENABLE", "true")
            monkeypatch.setenv("ROS_SECURITY_STRATEGY", strategy)
            monkeypatch.setenv("ROS_SECURITY_KEYSTORE", str(keystore))
            node = start_node(package, "--enclave", enclave)
            node.expected_code = 2
            assert node.wait() == 2
            (line,) = [text for text in node.output.splitlines() if text.startswith("error: ")]
            return line

        return reason

    @pytest.mark.parametrize("strategy", ["Enforce", "Permissive"])
    def test_a_node_with_an_enclave_does_not_start(self, refusal, strategy):
        line = refusal("milling_plant", "/axis", strategy)
        assert "doesn't have the security libraries" in line

    def test_a_node_without_its_enclave_does_not_start(self, refusal):
        line = refusal("mpc_controller", "/other", "Enforce")
        assert "SECURITY ERROR" in line

    def test_neither_does_the_tuner(self, tune, keystore):
        line = tune(
            *("--ros-args", "--enclave", "/axis"),
            ROS_SECURITY_ENABLE="true",
            ROS_SECURITY_STRATEGY="Enforce",
            ROS_SECURITY_KEYSTORE=str(keystore),
        )
        assert line.finish() == 2
        (refusal,) = [text for text in line.err.splitlines() if text.startswith("error: ")]
        assert "doesn't have the security libraries" in refusal
