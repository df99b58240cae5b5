"""Entry point of the command, for ``ros2 run tuning_benchmark`` and the shell."""

import sys
from typing import NoReturn

from bo_tuner.cli.executables import run


def benchmark() -> NoReturn:
    """Compare algorithms and optimizers over many runs."""
    run("tuning_benchmark.command", sys.argv[1:])
