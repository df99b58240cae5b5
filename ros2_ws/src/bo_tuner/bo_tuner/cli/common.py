"""What all commands share: their parser, and one line for each mistake."""

import argparse
import os
import signal
import sys
from collections.abc import Callable, Sequence
from io import TextIOWrapper
from typing import NoReturn

from threadpoolctl import threadpool_limits

from bo_tuner.backends.protocol import BACKENDS
from bo_tuner.cli.exit_codes import EXIT_SIGNAL, EXIT_USAGE
from bo_tuner.errors import BackendError, JournalError, OutputError, RunRecordError, StudyError
from bo_tuner.interruption import Interrupted, Interruption
from bo_tuner.storage.record import RunRecord

Run = Callable[[Sequence[str], Interruption], int]


class Parser(argparse.ArgumentParser):
    """Parser of a command line that keeps the line breaks of its texts.

    Parameters
    ----------
    prog
        Name of the command.
    description, epilog
        Texts before and after the options.
    """

    def __init__(self, prog: str, description: str, epilog: str) -> None:
        super().__init__(
            prog=prog,
            description=description,
            epilog=epilog,
            formatter_class=argparse.RawDescriptionHelpFormatter,
            allow_abbrev=False,
        )

    def error(self, message: str) -> NoReturn:
        """Say what is wrong in one line, without the usage."""
        self.exit(EXIT_USAGE, f"error: {message} ({self.prog} --help tells more)\n")


def guarded(run: Run) -> Run:
    """Make of each foreseen error of a command one line and exit code 2, and of a signal its code.

    Parameters
    ----------
    run
        Takes the command line without the command, and what ends it on a signal; returns the exit
        code.
    """

    def guard(argv: Sequence[str], interruption: Interruption) -> int:
        for stream in (sys.stdout, sys.stderr):
            if isinstance(stream, TextIOWrapper):
                # A terminal that cannot show a sign of ours gets a question mark, not an error.
                stream.reconfigure(errors="replace")
        try:
            # More threads than one only slow down the small matrices of the surrogates.
            with threadpool_limits(1):
                code = run(argv, interruption)
            # Here, where it is known what to do about a reader that has gone.
            sys.stdout.flush()
            return code
        except (StudyError, OutputError, BackendError, JournalError, RunRecordError) as error:
            sys.stderr.write(f"error: {' '.join(str(error).split())}\n")
            return EXIT_USAGE
        except BrokenPipeError:
            # Whoever read the output has had enough; nothing may be flushed to it any more.
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
            return EXIT_SIGNAL + signal.SIGPIPE
        except Interrupted as interrupt:
            sys.stderr.write(f"interrupted by {interrupt}\n")
            return EXIT_SIGNAL + interrupt.signum

    return guard


def recorded_backend(record: RunRecord) -> str:
    """Return the backend that a run is on.

    Raises
    ------
    RunRecordError
        If there is no such backend.
    """
    if record.backend not in BACKENDS:
        raise RunRecordError(f"{record.path}: unknown backend {record.backend!r} in its record")
    return record.backend


def split_ros_arguments(argv: Sequence[str]) -> tuple[list[str], list[str]]:
    """Part the own arguments from those between ``--ros-args`` and ``--``, or the end."""
    own: list[str] = []
    ros: list[str] = []
    inside = False
    for argument in argv:
        starts = argument == "--ros-args"
        ends = inside and argument == "--"
        (ros if inside or starts else own).append(argument)
        inside = starts or (inside and not ends)
    return own, ros
