"""Started nodes and what they start: all of it ends, also what was stopped."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from commands import environment
from waiting import wait_until

from bo_tuner.backends.ros import processes
from bo_tuner.backends.ros.processes import NodeProcess

# A node behind a shell script, which does not pass signals on, and a helper of the node's.
WRAPPER = """#!/bin/sh
"$PYTHON" -c "$NODE" "$1" &
wait
"""
NODE = """
import os, signal, subprocess, sys, time
if sys.argv[1] == "deaf":
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
helper = subprocess.Popen([sys.executable, "-S", "-c", "import time; time.sleep(600)"])
with open("pids.new", "w") as file:
    print(os.getpid(), helper.pid, file=file)
os.rename("pids.new", "pids")
time.sleep(600)
"""
TUNER = """
import sys, time
from pathlib import Path
from bo_tuner.backends.ros.processes import NodeProcess
NodeProcess("axis", ["lib/axis/axis", sys.argv[1]], {}, Path("log"))
time.sleep(600)
"""


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A folder with the node; the paths are relative to it."""
    program = tmp_path / "lib" / "axis" / "axis"
    program.parent.mkdir(parents=True)
    program.write_text(WRAPPER)
    program.chmod(0o755)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path))
    monkeypatch.setenv("NODE", NODE)
    monkeypatch.setenv("PYTHON", sys.executable)
    yield tmp_path
    for pid in pids(tmp_path):
        if runs(pid):
            os.kill(pid, signal.SIGKILL)


def pids(folder):
    file = folder / "pids"
    return [int(pid) for pid in file.read_text().split()] if file.exists() else []


def runs(pid):
    """Whether a process runs; one that nobody has asked for its exit code does not."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def stop_by_signal(pid):
    os.kill(pid, signal.SIGSTOP)


def leave(pid):
    pass


@pytest.mark.parametrize("how", ["", "deaf"])
@pytest.mark.parametrize("before", [leave, stop_by_signal])
class TestEnd:
    def test_stopped_by_the_tuner(self, folder, monkeypatch, how, before):
        if how == "deaf":
            monkeypatch.setattr(processes, "STOP_TIMEOUT", 2.0)
        process = NodeProcess("axis", ["lib/axis/axis", how], {}, folder / "log")
        wait_until(lambda: pids(folder), "the node")
        before(pids(folder)[0])
        before(process.pid)
        process.stop()
        assert process.exit_reason == "axis was ended by SIGTERM"
        wait_until(lambda: not any(map(runs, pids(folder))), "the end")

    def test_the_tuner_is_killed(self, folder, how, before):
        tuner = subprocess.Popen([sys.executable, "-c", TUNER, how], env=environment())
        try:
            wait_until(lambda: pids(folder), "the node", tuner)
            before(pids(folder)[0])
        finally:
            tuner.kill()
            tuner.wait()
        wait_until(lambda: not any(map(runs, pids(folder))), "the end")


def test_the_guard_of_a_program_that_cannot_run_ends(folder):
    (folder / "lib/axis/axis").write_text("#!/no/such/interpreter\n")
    with pytest.raises(processes.BackendError, match="cannot be started"):
        NodeProcess("axis", ["lib/axis/axis"], {}, folder / "log")
    for task in Path("/proc/self/task").iterdir():
        assert processes.GUARD not in [command_of(pid) for pid in children_of(task)]


def children_of(task):
    return (task / "children").read_text().split()


def command_of(pid):
    try:
        return Path(f"/proc/{pid}/cmdline").read_text().split("\0")[2]
    except (OSError, IndexError):
        return ""


@pytest.mark.parametrize(
    ("script", "reason"),
    [
        ("exit 3", "axis ended with exit code 3; it has printed nothing"),
        ("echo started; echo no bus >&2; echo; exit 1",
         "axis ended with exit code 1; its last line is 'no bus', see LOG"),
        ("kill -SEGV $$", "axis was ended by SIGSEGV"),
        ("echo pure virtual method called; kill -ABRT $$",
         "axis was ended by SIGABRT; its last line is 'pure virtual method called', see LOG"),
        ("no_such_program 2>/dev/null",
         f"axis ended with exit code 127; it has printed nothing; {processes.MISSING}"),
        ("echo \"ModuleNotFoundError: No module named 'servo_msgs'\"; exit 1",
         "axis ended with exit code 1; its last line is 'ModuleNotFoundError: No module named "
         f"'servo_msgs'', see LOG; {processes.MISSING}"),
    ],
)  # fmt: skip
def test_how_a_node_has_ended_is_told_with_its_last_line(tmp_path, script, reason):
    log = tmp_path / "axis.log"
    process = NodeProcess("axis", ["/bin/sh", "-c", script], {}, log)
    wait_until(lambda: process.exit_reason is not None, "its end")
    assert process.exit_reason == reason.replace("LOG", str(log))
    process.stop()
