"""Entry points of the commands, for ``ros2 run bo_tuner`` and the shell."""

import importlib
import sys
from typing import NoReturn

from bo_tuner.interruption import Interruption

COMMANDS = ("tune", "report", "validate", "replay", "apply", "benchmark")


def tune() -> NoReturn:
    """Run a study, or go on with a run."""
    run("tune", sys.argv[1:])


def report() -> NoReturn:
    """Show a run as a page."""
    run("report", sys.argv[1:])


def validate() -> NoReturn:
    """Certify the result of a run."""
    run("validate", sys.argv[1:])


def replay() -> NoReturn:
    """Repeat a cut of a run from its record."""
    run("replay", sys.argv[1:])


def apply() -> NoReturn:
    """Set the result of a run on a live controller."""
    run("apply", sys.argv[1:])


def benchmark() -> NoReturn:
    """Compare algorithms and optimizers over many runs."""
    run("benchmark", sys.argv[1:])


def run(command: str, argv: list[str]) -> NoReturn:
    """Run a command and exit with its code."""
    interruption = Interruption()
    # This import takes a second or two, in which Ctrl-C must not end in a traceback.
    module = importlib.import_module(f"bo_tuner.commands.{command}")
    sys.exit(module.run(argv, interruption))
