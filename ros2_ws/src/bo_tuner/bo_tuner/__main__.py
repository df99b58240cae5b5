"""``python -m bo_tuner COMMAND``: any of the commands without an installation's scripts."""

import sys

from bo_tuner.cli.executables import COMMANDS, module_of, run

if __name__ == "__main__":
    if len(sys.argv) < 2 or sys.argv[1] not in COMMANDS:
        sys.exit(f"error: expected one of {', '.join(COMMANDS)} (python -m bo_tuner tune --help)")
    run(module_of(sys.argv[1]), sys.argv[2:])
