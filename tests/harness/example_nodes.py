"""Nodes of the examples, started as a user starts them."""

import subprocess
import sys
from pathlib import Path

UNCHANGED = Path(__file__).parents[2] / "examples" / "unchanged_system"


def start_script(script, log, *arguments, env=None):
    """Start a node whose output goes to a file."""
    with log.open("w") as output:
        return subprocess.Popen(
            [sys.executable, script, *arguments],
            env=env,
            stdin=subprocess.DEVNULL,
            stdout=output,
            stderr=subprocess.STDOUT,
        )
