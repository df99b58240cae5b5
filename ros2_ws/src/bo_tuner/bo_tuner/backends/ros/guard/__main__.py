"""The guard that a tuner starts: ``python -m bo_tuner.backends.ros.guard``.

Its settings are the first line of standard input, heartbeats the rest. What keeps it from starting
is the only line that it writes to standard output.
"""

import json
import os
import sys
from pathlib import Path

from bo_tuner.backends.ros.guard.guard import Guard, PipeBeats, end_on_signals
from bo_tuner.backends.ros.guard.plan import Patience, Plan
from bo_tuner.errors import BackendError, StudyError
from bo_tuner.study.study_file import parse_study


def main() -> int:
    """Guard until the tuner has ended; returns the exit code."""
    settings = json.loads(_first_line())
    study, values = parse_study(settings["study"]), settings["values"]
    if values is None:
        plan = Plan.of(study, attached=settings["attached"])
    else:
        plan = Plan.of_values(study, values)
    guard = None
    try:
        guard = Guard(
            plan,
            settings["ros_arguments"],
            PipeBeats(sys.stdin.fileno()),
            name=settings["name"],
            patience=Patience(*settings["patience"]),
            attached=settings["attached"],
            record=Path(settings["record"]) if settings["record"] else None,
            say=_say,
        )
        end_on_signals(guard)
        # What gives values back stands for the moment in which others are set.
        guard.open(wait=False, alone=values is None)
        guard.serve()
    except (BackendError, StudyError) as error:
        sys.stdout.write(f"{error}\n")
        return 1
    finally:
        if guard is not None:
            guard.close()
    return 0


def _first_line() -> bytes:
    """Read the first line and not a byte more."""
    line = b""
    while not line.endswith(b"\n"):
        byte = os.read(sys.stdin.fileno(), 1)
        if not byte:
            sys.exit(1)
        line += byte
    return line


def _say(text: str) -> None:
    sys.stderr.write(f"guard: {text}\n")
    sys.stderr.flush()


if __name__ == "__main__":
    sys.exit(main())
