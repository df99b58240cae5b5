"""Waiting for a condition, never for a time.

The deadline is there for what never comes. It is far above what any machine needs, since a test
that is right must not fail for other programs' load.
"""

import os
import signal
import time
from pathlib import Path

DEADLINE = 300.0


def wait_until(condition, what, process=None, said=lambda: ""):
    """Wait until a condition holds, as long as a process runs; `said` tells more of a failure."""
    end = time.monotonic() + DEADLINE
    while not condition():
        assert process is None or process.poll() is None or condition(), (
            f"ended before {what}: {said()}"
        )
        assert time.monotonic() < end, f"waited {DEADLINE} s for {what}: {said()}"
        time.sleep(0.01)


def catches(pid, signum=signal.SIGTERM):
    """Whether a process has a handler of its own for a signal.

    Python has one for SIGINT from its start on, for others only if the program sets it.
    """
    return in_mask(Path(f"/proc/{pid}"), "SigCgt", signum)


def in_mask(task, mask, signum):
    """Whether a signal is in a mask of a process or thread, by its folder in /proc."""
    status = (task / "status").read_text()
    (bits,) = (line.split()[1] for line in status.splitlines() if line.startswith(f"{mask}:"))
    return bool(int(bits, 16) >> (signum - 1) & 1)


def count_in(path):
    """Number in a file that a program counts up in; 0 as long as there is none."""
    return int(path.read_text() or 0) if os.path.exists(path) else 0  # noqa: PTH110
