"""Entry point of the command, for the shell, ``ros2 run`` and ``python -m tuning_benchmark``."""

import os
import sys
from typing import NoReturn

from bo_tuner.cli.executables import run


def benchmark() -> NoReturn:
    """Compare algorithms and optimizers over many runs."""
    try:
        run("tuning_benchmark.command", sys.argv[1:])
    except SystemExit as end:
        execution = sys.modules.get("tuning_benchmark.campaign.execution")
        if execution is not None and execution.at_work():
            # At the end of the interpreter its thread would be cut off in the midst of the task,
            # which compiled code answers with an abort.
            os._exit(int(end.code or 0))
        raise


if __name__ == "__main__":
    benchmark()
