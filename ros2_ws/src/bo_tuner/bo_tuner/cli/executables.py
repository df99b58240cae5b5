"""Entry points of the commands, for ``ros2 run bo_tuner`` and the shell."""

import importlib
import signal
import sys
from typing import NoReturn

from bo_tuner.cli.streams import open_streams
from bo_tuner.interruption import SIGNALS, Interruption


def tune() -> NoReturn:
    """Run a study, or resume a run."""
    run("bo_tuner.cli.tune", sys.argv[1:])


def report() -> NoReturn:
    """Write the report of a run."""
    run("bo_tuner.cli.report", sys.argv[1:])


def validate() -> NoReturn:
    """Certify the result of a run."""
    run("bo_tuner.cli.validate", sys.argv[1:])


def replay() -> NoReturn:
    """Repeat an evaluation of a run from its record."""
    run("bo_tuner.cli.replay", sys.argv[1:])


def recompute() -> NoReturn:
    """Compute the metrics of a run again from its bags."""
    run("bo_tuner.cli.recompute", sys.argv[1:])


def apply() -> NoReturn:
    """Set the result of a run on live nodes."""
    run("bo_tuner.cli.apply", sys.argv[1:])


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
