"""Entry point of the command, for the shell, ``ros2 run`` and ``python -m tuning_benchmark``."""

import sys
from typing import NoReturn

from bo_tuner.cli.executables import run


def benchmark() -> NoReturn:
    """Compare algorithms and optimizers over many runs."""
    run("tuning_benchmark.command", sys.argv[1:])


if __name__ == "__main__":
    benchmark()
