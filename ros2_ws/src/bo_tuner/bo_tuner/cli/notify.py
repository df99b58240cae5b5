"""``--notify``: a command of the user's at the end of a run or a certificate."""

import contextlib
import os
import signal
import subprocess
from collections.abc import Callable
from pathlib import Path

from bo_tuner.cli.common import Group

PATIENCE = 30.0
"""Time [s] that the command has; the end of the run is not to wait for a server for long."""
STANDARD_ERROR = 2


def add_notify_argument(group: Group) -> None:
    """Add the option that names the command."""
    group.add_argument(
        "--notify",
        metavar="COMMAND",
        help="run this shell command at the end, also after an interruption; its environment has "
        "BO_TUNER_EXIT_CODE, BO_TUNER_FOLDER (the run folder) and BO_TUNER_HEADLINE",
    )


def notify(
    command: str | None, folder: Path, code: int, headline: str, warn: Callable[[str], None]
) -> None:
    """Run the command, and wait for its end; one that fails is a warning and nothing more."""
    if command is None:
        return
    variables = {
        "BO_TUNER_EXIT_CODE": str(code),
        "BO_TUNER_FOLDER": str(folder.resolve()),
        "BO_TUNER_HEADLINE": headline,
    }
    try:
        process = subprocess.Popen(
            ["/bin/sh", "-c", command],
            env=os.environ | variables,
            stdin=subprocess.DEVNULL,
            # Standard output is that of our command alone: another program may read it.
            stdout=STANDARD_ERROR,
            # So that what it has started can be ended with it.
            start_new_session=True,
        )
    except (OSError, ValueError) as error:
        warn(f"warning: --notify: the command cannot be run: {error}")
        return
    try:
        status = process.wait(PATIENCE)
    except subprocess.TimeoutExpired:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()
        warn(f"warning: --notify: the command did not end within {PATIENCE:g} s, and was ended")
        return
    if status != 0:
        warn(f"warning: --notify: the command failed with exit code {status}")
