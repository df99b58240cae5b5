"""A Dask cluster of processes, as somebody starts it by hand, on this host or on several."""

import contextlib
import json
import os
import signal
import subprocess
import sys

from commands import ONE_THREAD, environment
from distributed import Client
from waiting import wait_until

OPTIONS = ("--no-dashboard", "--nthreads", "1")


class Host:
    """A network of its own on this machine, with one way out: to this host's address `gateway`.

    Raises
    ------
    OSError, subprocess.CalledProcessError
        If this user may not make one.
    """

    def __init__(self, number):
        self.name = f"bo-tuner-{os.getpid()}-{number}"
        inside, outside = f"bt{os.getpid()}i{number}", f"bt{os.getpid()}o{number}"
        subnet = f"10.213.{4 * (os.getpid() % 60) + number}"
        self.gateway, self.address = f"{subnet}.1", f"{subnet}.2"
        ip("netns", "add", self.name)
        try:
            ip("link", "add", outside, "type", "veth", "peer", "name", inside)
            ip("link", "set", inside, "netns", self.name)
            ip("address", "add", f"{self.gateway}/24", "dev", outside)
            ip("link", "set", outside, "up")
            ip("-n", self.name, "address", "add", f"{self.address}/24", "dev", inside)
            ip("-n", self.name, "link", "set", inside, "up")
            ip("-n", self.name, "link", "set", "lo", "up")
        except BaseException:
            self.close()
            raise

    def close(self):
        """Take the network away, and with it both ends of its line."""
        ip("netns", "delete", self.name)


def ip(*arguments):
    """Change the network."""
    subprocess.run(["ip", *arguments], check=True, capture_output=True)


class Cluster:
    """A scheduler on this host, and workers.

    Parameters
    ----------
    folder
        Where its processes run, find modules, and write.
    options
        Of all its processes.
    scheme
        How they talk: ``tcp`` or ``tls``.
    """

    def __init__(self, folder, *options, scheme="tcp"):
        self.folder = folder
        self._options = options
        self._scheme = scheme
        self._processes = []
        self.log = folder / "dask.txt"
        file = folder / "scheduler.json"
        # Of an earlier cluster.
        file.unlink(missing_ok=True)
        self.scheduler = self._start(
            *("scheduler", "--protocol", scheme, "--port", "0", "--no-dashboard"),
            *("--scheduler-file", file),
        )
        wait_until(lambda: _address(file), "the scheduler", self.scheduler, self.log.read_text)
        self._port = _address(file).rsplit(":", 1)[1]
        self.address = f"{scheme}://127.0.0.1:{self._port}"

    def worker(self, *options, host=None, path=(), **variables):
        """Start a worker: on a host, with folders where it finds other modules first."""
        name = f"worker-{len(self._processes)}"
        gateway = "127.0.0.1" if host is None else host.gateway
        return self._start(
            "worker",
            *(f"{self._scheme}://{gateway}:{self._port}", *OPTIONS, "--name", name),
            *("--local-directory", self.folder / name),
            *options,
            within=() if host is None else ("ip", "netns", "exec", host.name),
            path=path,
            **variables,
        )

    def _start(self, kind, *arguments, within=(), path=(), **variables):
        command = [sys.executable, "-m", f"distributed.cli.dask_{kind}"]
        with self.log.open("a") as log:
            process = subprocess.Popen(
                [*within, *command, *map(str, arguments), *self._options],
                # Modules are to be found by the path alone.
                cwd="/",
                env=environment(*path, self.folder) | ONE_THREAD | variables,
                stdout=log,
                stderr=log,
                start_new_session=True,
            )
        self._processes.append(process)
        return process

    def kill(self, process):
        """End a process and those that it has started, as if their host were gone."""
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()

    def ask(self, act):
        """Have a function run in each worker; returns the answers."""
        with Client(self.address, set_as_default=False) as client:
            return list(client.run(act).values())

    def wait_for(self, workers):
        """Wait until so many workers are there."""
        with Client(self.address, set_as_default=False) as client:
            wait_until(
                lambda: len(client.nthreads()) == workers,
                f"{workers} workers",
                self.scheduler,
                self.log.read_text,
            )

    def close(self):
        """End all processes."""
        for process in reversed(self._processes):
            self.kill(process)


def _address(file):
    try:
        return json.loads(file.read_text())["address"]
    except (OSError, ValueError, KeyError):
        return ""
