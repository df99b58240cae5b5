"""Entry points of the commands, for ``ros2 run bo_tuner`` and the shell."""

import importlib
import signal
import sys
from functools import partial
from typing import NoReturn

from bo_tuner.cli.streams import open_streams
from bo_tuner.interruption import SIGNALS, Interruption

COMMANDS = ("tune", "report", "validate", "replay", "recompute", "apply", "guard")


def run(module: str, argv: list[str]) -> NoReturn:
    """Run the command in a module and exit with its code."""
    open_streams()
    interruption = Interruption()
    # This import takes a second or two, in which Ctrl-C must not end in a traceback. The threads
    # that libraries start meanwhile are to leave signals to this one: it may hold one back.
    signal.pthread_sigmask(signal.SIG_BLOCK, SIGNALS)
    command = importlib.import_module(module)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, SIGNALS)
    sys.exit(command.run(argv, interruption))


def _run_named(command: str) -> NoReturn:
    run(f"bo_tuner.cli.{command}", sys.argv[1:])


# One for each of the console scripts.
tune, report, validate, replay, recompute, apply, guard = (
    partial(_run_named, command) for command in COMMANDS
)
