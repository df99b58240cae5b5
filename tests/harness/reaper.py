"""Ends what a test process has started once that is gone, however it went."""

import contextlib
import os
import signal
import sys
import time
import uuid
from pathlib import Path

MARK = "STARTED_BY_TESTS"


def guard():
    """Have all that this process starts from now on killed when it has ended.

    Nodes may lead sessions of their own, and outlive whoever started them; the environment of their
    start tells whose they are.
    """
    environment = {name: value for name, value in os.environ.items() if name != MARK}
    mark = os.environ[MARK] = uuid.uuid4().hex
    # No other process gets the writing end, which is closed when this one ends.
    reading, _ = os.pipe()
    nowhere = [(os.POSIX_SPAWN_OPEN, stream, os.devnull, os.O_WRONLY, 0) for stream in (1, 2)]
    os.posix_spawn(
        sys.executable,
        [sys.executable, "-S", __file__, mark],
        environment,
        file_actions=[(os.POSIX_SPAWN_DUP2, reading, 0), *nowhere],
        setsid=True,
    )
    os.close(reading)


def marked(mark, variable=MARK):
    """Processes whose program was started with a mark in a variable of its environment."""
    entry = f"{variable}={mark}".encode()
    found = []
    for folder in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError):
            if entry in (folder / "environ").read_bytes().split(b"\0"):
                found.append(int(folder.name))
    return found


if __name__ == "__main__":
    sys.stdin.read()
    while left := marked(sys.argv[1]):
        for pid in left:
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)
        time.sleep(0.1)
