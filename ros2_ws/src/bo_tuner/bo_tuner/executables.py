"""Entry points of the commands, for ``ros2 run bo_tuner`` and the shell."""

import importlib
import sys
from typing import NoReturn

from bo_tuner.interruption import Interruption


def tune() -> NoReturn:
    """Run a study."""
    _run("tune")


def _run(command: str) -> NoReturn:
    interruption = Interruption()
    # This import takes a second or two, in which Ctrl-C must not end in a traceback.
    module = importlib.import_module(f"bo_tuner.commands.{command}")
    sys.exit(module.run(sys.argv[1:], interruption))
