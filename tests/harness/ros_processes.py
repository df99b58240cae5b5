"""Nodes as processes of their own, in a ROS domain of this test process."""

import fcntl
import signal
import socket
import subprocess
import tempfile
from pathlib import Path

from commands import Fork
from waiting import DEADLINE

FIRST_PORT, PORTS_PER_DOMAIN = 7400, 250


def claim_domain(worker):
    """Take a free ROS domain for this process: (domain, lock to hold).

    Workers of pytest-xdist look in ranges of their own, from above, as the tuner starts from below.
    """
    index = int(worker.removeprefix("gw") or 0)
    for offset in range(101):
        domain = 1 + (100 - 10 * index - offset) % 101
        path = Path(tempfile.gettempdir()) / f"milling-tests-domain-{domain}.lock"
        try:
            # Another user's file can be locked, but not be opened as if to be made.
            if not path.exists():
                path.touch()
            lock = path.open()
        except PermissionError:
            continue
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
                probe.bind(("", FIRST_PORT + PORTS_PER_DOMAIN * domain + 10))
            except OSError:
                lock.close()
                continue
        return domain, lock
    raise RuntimeError("no free ROS domain")


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
        ros_arguments = ["--ros-args", *arguments] if arguments else []
        with log.open("w") as output:
            self.popen = Fork(
                *ros_arguments, folder=log.parent, package=package, stdout=output, stderr=output
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
            # Where its threads are is in its log then, whatever lock they wait for.
            self.send(signal.SIGABRT)
            self.wait()
            raise AssertionError(f"it does not end: {self.output}") from None
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
