"""``python -m bo_tuner COMMAND``: any of the commands without an installation's scripts."""

import sys

from bo_tuner.cli import executables

COMMANDS = ("tune", "report", "validate", "replay", "recompute", "apply")

if __name__ == "__main__":
    if len(sys.argv) < 2 or sys.argv[1] not in COMMANDS:
        sys.exit(f"error: expected one of {', '.join(COMMANDS)} (python -m bo_tuner tune --help)")
    executables.run(f"bo_tuner.cli.{sys.argv[1]}", sys.argv[2:])
