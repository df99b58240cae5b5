"""Nodes as processes of their own, and a node of the test that talks to them.

Nothing here sleeps for a fixed time: whatever is waited for is polled with a deadline.
"""

import os
import subprocess
from pathlib import Path
from types import SimpleNamespace

import pytest
import tuner
from commands import ForkedGuard, start
from milling_nodes import Drive, Loop, StandInController, reset_parameters
from peer import Peer
from ros_processes import Starter, claim_domain, shared_memory_of

from bo_tuner.backends.ros.isolation import profile_variable

PROFILE = Path(__file__).parents[2] / "ros2_ws/src/bo_tuner/config/fastdds_profile.xml"


@pytest.fixture(scope="module", autouse=True)
def ros_environment(tmp_path_factory):
    """This machine only, a domain of this worker, no shared memory, logs and state in folders.

    The discovery range LOCALHOST would make rmw_fastrtps choose its own transports, with shared
    memory and whatever the profile or FASTDDS_BUILTIN_TRANSPORTS say. So the profile does it all.
    """
    domain, lock = claim_domain(os.environ.get("PYTEST_XDIST_WORKER", "gw"))
    with pytest.MonkeyPatch.context() as patch, lock:
        patch.setenv("ROS_DOMAIN_ID", str(domain))
        patch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "SUBNET")
        patch.setenv("FASTDDS_BUILTIN_TRANSPORTS", "UDPv4")
        patch.setenv(profile_variable(), str(PROFILE))
        patch.setenv("ROS_LOG_DIR", str(tmp_path_factory.mktemp("log")))
        # What a killed tuner of another module has left on its nodes is no matter here.
        patch.setenv("XDG_STATE_HOME", str(tmp_path_factory.mktemp("state")))
        patch.setenv("RCUTILS_COLORIZED_OUTPUT", "0")
        patch.setenv("ROS_PYTHON_CHECK_FIELDS", "1")
        before = shared_memory_of(domain)
        yield
        assert shared_memory_of(domain) <= before


@pytest.fixture(autouse=True)
def forked_guard(monkeypatch):
    """Guards of backends in this process are forked: their imports take longer than most runs."""
    forked = SimpleNamespace(
        Popen=ForkedGuard, PIPE=subprocess.PIPE, TimeoutExpired=subprocess.TimeoutExpired
    )
    monkeypatch.setattr("bo_tuner.backends.ros.guard.link.subprocess", forked)


@pytest.fixture
def empty_domain(ros_environment, monkeypatch):
    """Work in a domain without nodes: those that a module shares may run in that of the worker."""
    domain, lock = claim_domain(os.environ.get("PYTEST_XDIST_WORKER", "gw"))
    monkeypatch.setenv("ROS_DOMAIN_ID", str(domain))
    with lock:
        yield domain


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


@pytest.fixture(scope="module")
def shared_plant(start_shared_node):
    """A plant as a process, for all tests of a module."""
    return start_shared_node("milling_plant")


@pytest.fixture(scope="module")
def shared_controller(start_shared_node):
    """A controller as a process, for all tests of a module."""
    return start_shared_node("mpc_controller")


@pytest.fixture(scope="module")
def shared_pair(shared_plant, shared_controller):
    """Both: a second controller in the domain would answer the references of a drive, too."""
    return [shared_plant, shared_controller]


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


@pytest.fixture
def stand_in_controller(shared_plant, peer):
    """Function that sets parameters of the shared plant and takes the controller's place."""

    def make(answer=None, **parameters):
        reset_parameters(peer, ["milling_plant"])
        assert peer.set_parameters("milling_plant", parameters).successful
        return StandInController(peer, answer)

    return make


@pytest.fixture
def drive(shared_controller, peer):
    """A drive of the test for the shared controller at its shipped parameters."""
    reset_parameters(peer, ["mpc_controller"])
    return Drive(peer)


@pytest.fixture
def tune(tmp_path):
    """Function that starts the command: arguments, and the environment by keywords."""
    yield from tuner.starter(tmp_path)


@pytest.fixture(scope="module")
def start_tune(tmp_path_factory):
    """The same for a run that the tests of a module share, in an interpreter of its own."""
    yield from tuner.starter(tmp_path_factory.mktemp("tune"), start)


@pytest.fixture
def drive_study():
    """Function that makes a study of the small node."""
    return tuner.drive_study
