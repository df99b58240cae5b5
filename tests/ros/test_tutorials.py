"""The tutorials' commands as printed, in shells, but for the domain and the number of trials."""

import contextlib
import os
import re
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from waiting import DEADLINE, wait_until

from bo_tuner.cli.executables import COMMANDS

pytestmark = [pytest.mark.ros, pytest.mark.timeout(4 * DEADLINE), pytest.mark.slow]

ROOT = Path(__file__).parents[2]
NOT_HERE = ("ros2 ", "source ~", "make interfaces")
"""What needs an installation of ROS 2, or a C++ compiler (`.ci/run` has that)."""
LONG = ("validate ", "apply ")
"""What has tests of its own, and takes the result of a long run."""


def shell_blocks(page):
    text = (ROOT / "docs" / page).read_text(encoding="utf-8")
    return re.findall(r"^```sh\n(.*?)^```$", text, re.DOTALL | re.MULTILINE)


@pytest.fixture
def clone(tmp_path):
    """A folder that looks like a clone of the repository after ``make setup``."""
    (tmp_path / ".venv").symlink_to(sys.prefix)
    (tmp_path / "examples").symlink_to(ROOT / "examples")
    return tmp_path


@pytest.fixture
def terminal(clone, empty_domain):
    """Function that starts the lines of a terminal, whose output goes to a file of the clone."""
    shells = []

    def start(text, name):
        text = text.replace("ROS_DOMAIN_ID=42", f"ROS_DOMAIN_ID={empty_domain}")
        with (clone / name).open("w") as output:
            shells.append(
                subprocess.Popen(
                    ["bash", "-e", "-c", text],
                    cwd=clone,
                    stdin=subprocess.DEVNULL,
                    stdout=output,
                    stderr=subprocess.STDOUT,
                    start_new_session=True,
                )
            )
        return shells[-1]

    yield start
    for shell in shells:
        # Whatever the shell has started is in its group, which may have ended.
        with contextlib.suppress(ProcessLookupError):
            os.killpg(shell.pid, signal.SIGTERM)
        shell.wait(DEADLINE)


@pytest.mark.parametrize(
    ("page", "nodes"), [("tutorial_unchanged_system.md", 2), ("tutorial_your_own_node.md", 1)]
)
def test_a_tutorial(clone, terminal, page, nodes):
    first, *others = shell_blocks(page)
    running = terminal(first, "nodes.txt")
    printed = clone / "nodes.txt"
    wait_until(lambda: printed.read_text().count("ready") == nodes, "nodes", running)
    opening = "".join(f"{line}\n" for line in first.splitlines()[:2])
    assert "activate" in opening
    assert "ROS_DOMAIN_ID" in opening
    done = []
    for block in others:
        if block.startswith(LONG) or any(word in block for word in NOT_HERE):
            continue
        shorter = re.sub(r"(tune --study .*)", r"\1 --trials 3", block)
        code = terminal(opening + shorter, "commands.txt").wait(2 * DEADLINE)
        said = (clone / "commands.txt").read_text()
        assert "Traceback" not in said, said
        # Three trials may well find nothing feasible, and a busy machine fails a run.
        assert code in ((0,) if block.startswith("init ") else (0, 3)), (block, said)
        done += [line for line in block.splitlines() if line.split(" ")[0] in COMMANDS]
    assert len(done) >= nodes + 1, done
    assert running.poll() is None
