"""``ros2 run bo_tuner tune``: run a study and report what it found."""

import sys
from collections.abc import Sequence
from typing import NoReturn

from bo_tuner.interruption import Interruption


def main(argv: Sequence[str] | None = None) -> NoReturn:
    """Run the command and exit with its code."""
    interruption = Interruption()
    # These imports take a second or two, in which Ctrl-C must not end in a traceback.
    from bo_tuner.command_line import run

    sys.exit(run(list(sys.argv[1:] if argv is None else argv), interruption))


if __name__ == "__main__":
    main()
