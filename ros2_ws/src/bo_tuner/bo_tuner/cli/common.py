"""Shared by all commands: the argument parser, and errors as one line and an exit code."""

import argparse
import contextlib
import errno
import signal
import sqlite3
import sys
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import NoReturn

from threadpoolctl import threadpool_limits

from bo_tuner.backends.protocol import Backend
from bo_tuner.backends.ros.isolation import in_namespace, named_namespace
from bo_tuner.cli.exit_codes import EXIT_FAULT, EXIT_SIGNAL, EXIT_USAGE, early_end
from bo_tuner.cli.streams import discard_output, say_error
from bo_tuner.codec import checks
from bo_tuner.errors import (
    BackendError,
    JournalError,
    MethodError,
    OutputError,
    RunError,
    RunRecordError,
    StudyError,
)
from bo_tuner.interruption import Interrupted, Interruption
from bo_tuner.storage.provenance import OWN_PACKAGE, commit, version_of
from bo_tuner.storage.record import RunRecord, read_run
from bo_tuner.storage.run_folder import LATEST
from bo_tuner.storage.trust import check_trust, python_functions, trust
from bo_tuner.study.function_study import FUNCTION
from bo_tuner.study.parts import BACKENDS, ROS
from bo_tuner.study.study import Study
from bo_tuner.trials import Trial
from bo_tuner.tuning.summary import with_summary

RUNS = Path("runs")
"""Where run folders are created, and looked for."""

Run = Callable[[Sequence[str], Interruption], int]
"""A command: takes its command line, which may hold ``--ros-args`` where nodes are used, and the
interruption, which ends it on a signal. Returns its exit code, or exits after a wrong option."""


Group = argparse._ArgumentGroup
"""Options that stand together in the help."""


class Parser(argparse.ArgumentParser):
    """An argument parser that keeps the line breaks of its texts."""

    def __init__(self, prog: str, description: str, epilog: str) -> None:
        super().__init__(
            prog=prog,
            description=description,
            epilog=epilog,
            formatter_class=argparse.RawDescriptionHelpFormatter,
            allow_abbrev=False,
        )
        self.add_argument(
            "--version",
            action="version",
            version=f"{prog} {version_of(OWN_PACKAGE)} (commit {commit()})",
            help="show version and commit, and exit",
        )

    def add_run_argument(
        self, what: str = "run folder", *, several: bool = False, optional: bool = False
    ) -> None:
        """Add the positional argument ``run``; if there may be `several`, a list, maybe empty."""
        self.add_argument(
            "run",
            type=Path,
            nargs="*" if several else "?" if optional else None,
            metavar="RUN",
            help=f"{what}, or '{LATEST}' for {RUNS / LATEST}",
        )

    def add_backend_arguments(self, default: str, trust: str = "") -> None:
        """Add a group of options that say where evaluations run."""
        group = self.add_argument_group("nodes")
        group.add_argument(
            "--backend",
            choices=BACKENDS,
            help=f"run on ROS nodes, or on the same objects in this process (default: {default})",
        )
        group.add_argument(
            "--attach",
            action=argparse.BooleanOptionalAction,
            help="use running nodes instead of starting them (default: as in the run, if there "
            "is one)",
        )
        self.add_trust_argument(trust, group)

    def add_trust_argument(self, condition: str = "", group: Group | None = None) -> None:
        """Add the option to start what a study names; `condition` is put ahead of its help."""
        (group or self).add_argument(
            "--trust",
            action="store_true",
            help=f"{condition}start the programs and import the objects that the run's study "
            "names, now and later; read the study first if the run is not yours",
        )

    def error(self, message: str) -> NoReturn:
        """Exit with one line on the error, without the usage."""
        say_error(f"error: {message} (see {self.prog} --help)")
        self.exit(EXIT_USAGE)

    def _print_message(self, message: str, file: object = None) -> None:
        # Help and version; argparse itself passes over what cannot be written, and exits with 0.
        sys.stdout.write(message)
        sys.stdout.flush()


def guarded(run: Run) -> Run:
    """Decorate a command: its expected errors become one line and exit code 2, a signal its code.

    A full disk and a run that cannot go on are faults, with exit code 1.
    """

    def guard(argv: Sequence[str], interruption: Interruption) -> int:
        try:
            # More than one thread only slows down the small matrices of the surrogates.
            with threadpool_limits(1):
                code = run(argv, interruption)
            # Flushed here, where a closed pipe is handled.
            sys.stdout.flush()
            return code
        except StudyError as error:
            for each in (error, *error.others):
                say_error(f"error: {each}")
            return EXIT_USAGE
        except (OutputError, BackendError, JournalError, MethodError, RunRecordError) as error:
            say_error(f"error: {error}")
            return EXIT_FAULT if _is_full(error) else EXIT_USAGE
        except (RunError, Interrupted) as error:
            text, code = early_end(error)
            say_error(text)
            return code
        except OSError as error:
            return _fault(error, interruption)
        finally:
            discard_output()

    return guard


def _is_full(error: Exception) -> bool:
    """Return whether an error is one of a full disk, and not of what the user has given."""
    cause = error.__cause__
    if isinstance(cause, sqlite3.Error):
        return getattr(cause, "sqlite_errorcode", None) == sqlite3.SQLITE_FULL
    return isinstance(cause, OSError) and cause.errno in (errno.ENOSPC, errno.EDQUOT)


def _fault(error: OSError, interruption: Interruption) -> int:
    """Show, where that is possible, what could not be read or written; returns the exit code."""
    if interruption.signum is not None:
        # A terminal that is gone sends SIGHUP, and takes no more output.
        return EXIT_SIGNAL + interruption.signum
    if isinstance(error, BrokenPipeError):
        say_error("error: the output pipe was closed")
        return EXIT_SIGNAL + signal.SIGPIPE
    where = f"{error.filename}: " if error.filename else "output: "
    say_error(f"error: {where}{error.strerror or error}")
    return EXIT_FAULT


@contextlib.contextmanager
def opened(
    backend: Backend, interruption: Interruption, *, again: bool = False
) -> Iterator[list[str]]:
    """Open a backend for a ``with`` block, and close it whatever comes, signals included."""
    left: list[str] = []
    try:
        interruption.check()
        if backend.name == ROS:
            interruption.keep_running()
        backend.open()
        yield left
    except BaseException:
        again = False
        raise
    finally:
        if not again:
            interruption.ignore()
        try:
            backend.close()
        except BackendError as error:
            say_error(f"error: {error}")
            left.append(str(error))


def ended(left: Sequence[str], code: int) -> int:
    """Return the exit code of a command that has come to its end."""
    return EXIT_FAULT if left else code


def whole_number(text: str) -> int:
    """Read an option's whole number."""
    try:
        return int(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text}: expected a whole number") from None


def fraction(text: str) -> float:
    """Read an option's number between 0 and 1."""
    try:
        value = float(text)
    except ValueError:
        value = float("nan")
    if not 0.0 < value < 1.0:
        raise argparse.ArgumentTypeError(f"{text}: expected a number between 0 and 1")
    return value


def named_metrics(text: str, study: Study) -> list[str]:
    """Return the metrics that an option ``--metrics`` names, each once."""
    names = [name.strip() for name in text.split(",")]
    for name in names:
        if name not in study.metrics:
            raise StudyError(
                f"--metrics: expected some of {', '.join(study.metrics)}, found "
                f"{checks.quoted(name)}"
            )
    return list(dict.fromkeys(names))


def recorded_backend(record: RunRecord) -> str:
    """Return the name of a run's backend."""
    if record.backend == FUNCTION:
        raise RunRecordError(
            f"{record.path}: is a run of a Python function, which no command can call; go on with "
            "it from Python"
        )
    if record.backend not in BACKENDS:
        raise RunRecordError(f"{record.path}: unknown backend {record.backend!r} in its record")
    return record.backend


def asks_for_running_nodes(arguments: argparse.Namespace) -> str:
    """Return the option that asks for running nodes; empty if none is given."""
    given = (name for name in ("benches", "attach") if getattr(arguments, name, None))
    return f"--{name}" if (name := next(given, "")) else ""


def attached(
    arguments: argparse.Namespace, parser: Parser, backend: str, record: RunRecord | None
) -> bool:
    """Return whether to use running nodes: by the option, or else if the run did."""
    if arguments.attach and backend != ROS:
        parser.error(f"{asks_for_running_nodes(arguments)} needs --backend ros")
    if arguments.attach is not None or record is None:
        return bool(arguments.attach)
    return record.options.attached and backend == ROS


def in_namespace_of(record: RunRecord, ros_arguments: Sequence[str]) -> list[str]:
    """Return the ``--ros-args`` of a command on a run: in its namespace by default."""
    if named_namespace(ros_arguments) or record.options.namespace in ("", "/"):
        return list(ros_arguments)
    return in_namespace(ros_arguments, record.options.namespace)


def allow_programs(record: RunRecord, *, trusted: bool, attach: bool) -> None:
    """Refuse to start what the study of a stranger's run names, unless the user trusts it."""
    if trusted:
        trust(record.study)
    elif not attach or python_functions(record.study):
        check_trust(record.study, record.path)


def run_folder(given: Path) -> Path:
    """Return the run folder that an argument names; ``latest`` alone is the latest in ``runs/``."""
    if given != Path(LATEST) or given.exists():
        return given
    if not (RUNS / LATEST).exists():
        raise RunRecordError(f"{RUNS / LATEST}: no such run folder; give its path")
    return RUNS / LATEST


def read_result(given: Path) -> RunRecord:
    """Read the run that an argument names, with its summary; what is wrong with that is shown."""
    return with_summary(read_run(run_folder(given)), say_error)


def trial_of(record: RunRecord, number: object) -> Trial:
    """Return the trial of a run with a number."""
    trials = {trial.number: trial for trial in record.trials}
    if number not in trials:
        known = f"expected 0 to {len(trials) - 1}" if trials else "the run has none"
        raise RunRecordError(f"{record.path}: no trial {number}; {known}")
    return trials[number]


def split_ros_arguments(argv: Sequence[str]) -> tuple[list[str], list[str]]:
    """Separate the own arguments from those between ``--ros-args`` and ``--`` or the end."""
    own: list[str] = []
    ros: list[str] = []
    inside = False
    for argument in argv:
        starts = argument == "--ros-args"
        ends = inside and argument == "--"
        (ros if inside or starts else own).append(argument)
        inside = starts or (inside and not ends)
    return own, ros
