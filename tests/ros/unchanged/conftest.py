"""The servo, at work in a thread, and a backend that is attached to it."""

import threading
from pathlib import Path

import pytest
from node_threads import at_work
from rclpy.node import Node
from servo import System, study
from std_msgs.msg import Float64
from std_srvs.srv import Trigger
from waiting import DEADLINE, wait_until

from bo_tuner.backends.ros import preparation, procedure, publication, steps
from bo_tuner.backends.ros.backend import RosBackend
from bo_tuner.errors import StudyError
from bo_tuner.interruption import Interrupted


@pytest.fixture(scope="module")
def machine():
    """The system, at work in a thread, and a node whose services nobody serves."""
    with at_work(System) as system:
        idle = Node("idle", context=system.context)
        idle.create_service(Trigger, "hang", lambda request, response: response)
        for node in (system, idle):
            node.create_publisher(Float64, "twice", 10)
        yield system
        idle.destroy_node()


@pytest.fixture
def system(machine):
    """The system as it is at first."""
    machine.begin()
    return machine


@pytest.fixture
def join(machine):
    """Function that makes a node and lets it work beside the system."""
    executor, nodes = machine.executor, []

    def make(cls, *arguments):
        nodes.append(cls(*arguments, context=machine.context))
        executor.add_node(nodes[-1])
        executor.wake()
        return nodes[-1]

    yield make
    for node in nodes:
        executor.remove_node(node)
        node.destroy_node()


@pytest.fixture
def leave(machine):
    """Function that ends a node that has joined."""

    def end(node):
        machine.executor.remove_node(node)
        node.destroy_node()

    return end


@pytest.fixture
def patience(monkeypatch):
    """Function that sets how long [s] a backend waits for what it does not find."""

    def wait(seconds):
        for module in (steps, publication, procedure, preparation):
            monkeypatch.setattr(module, "CONNECT_TIMEOUT", seconds)

    return wait


@pytest.fixture
def patient(monkeypatch, patience):
    """Waits long for what a busy machine is slow to show, and not at all for what is not there."""
    patience(DEADLINE)
    for name, value in (
        ("bringup.LOOK_AROUND", 0.1),
        ("bringup.ATTACH_TIMEOUT", DEADLINE),
        ("safe_state.PARK_TIMEOUT", DEADLINE),
        ("backend.PARK_TIMEOUT", DEADLINE),
    ):
        monkeypatch.setattr(f"bo_tuner.backends.ros.{name}", value)


@pytest.fixture
def backend(system, tmp_path, patient):
    """Function that opens a backend for a study."""
    opened = []

    def make(**changes):
        made = RosBackend(study(**changes), Path(tmp_path), attach=True)
        opened.append(made)
        made.open()
        return made

    make.opened = opened
    yield make
    # One that refuses or is silent could not be set back.
    system.begin()
    for made in opened:
        made.close()


@pytest.fixture
def killed():
    """Function that lets a backend go as `kill -9` does: it says nothing to the nodes any more."""

    def kill(backend):
        backend._procedure.close()
        backend._tuner.close()
        backend._claim.release()
        backend._procedure = backend._tuner = backend._claim = None

    return kill


@pytest.fixture
def interruptible(system, tmp_path, patient):
    """Function that opens a backend whose waits end, as by Ctrl-C, from a moment on."""
    opened = []

    def make(when, **changes):
        asked = []

        def interrupted():
            if asked or when():
                asked.append(True)
                raise Interrupted(2)

        made = RosBackend(study(**changes), tmp_path, attach=True, interrupted=interrupted)
        opened.append(made)
        made.open()
        return made

    yield make
    for made in opened:
        made.close()


@pytest.fixture
def in_run():
    """Function that does something, in a thread, in the midst of the next run of a backend."""
    threads = []

    def do(backend, action):
        def wait():
            procedure = backend._procedure
            wait_until(
                lambda: procedure._is_recording and procedure._recorder.seconds > 0.5, "a run"
            )
            action()

        threads.append(threading.Thread(target=wait))
        threads[-1].start()

    yield do
    for thread in threads:
        thread.join()


@pytest.fixture
def refusal(backend, patience):
    """Function that opens a backend for a study that is refused, and returns the reason."""

    def reason(**changes):
        patience(2.0)
        with pytest.raises(StudyError) as caught:
            backend(**changes)
        return str(caught.value)

    return reason
