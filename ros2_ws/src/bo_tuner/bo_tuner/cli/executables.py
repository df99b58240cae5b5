"""Entry points of the commands, for ``ros2 run bo_tuner`` and the shell."""

import importlib
import os
import signal
import sys
import time
from functools import partial
from keyword import iskeyword
from typing import NoReturn

from bo_tuner.cli.exit_codes import EXIT_FAULT, EXIT_USAGE
from bo_tuner.cli.streams import open_streams, say_error
from bo_tuner.interruption import SIGNALS, Interruption

ROS = (
    "action_msgs", "builtin_interfaces", "diagnostic_msgs", "lifecycle_msgs", "rcl_interfaces",
    "rclpy", "rosgraph_msgs", "rosidl_parser", "std_msgs", "std_srvs",
)  # fmt: skip
"""What ROS installs; no requirement of the package, which is of use as a library without it."""

COMMANDS = (
    "tune", "init", "check", "try", "report", "validate", "replay", "recompute", "identify",
    "apply", "guard",
)  # fmt: skip

DATE = "SOURCE_DATE_EPOCH"
"""Variable of the environment with the time that builds have instead of the present one."""


def run(module: str, argv: list[str]) -> NoReturn:
    """Run the command in a module and exit with its code."""
    open_streams()
    _check_date()
    interruption = Interruption()
    # This import takes a second or two, in which Ctrl-C must not end in a traceback. The threads
    # that libraries start meanwhile are to leave signals to this one: it may hold one back.
    signal.pthread_sigmask(signal.SIG_BLOCK, SIGNALS)
    try:
        command = importlib.import_module(module)
    except ModuleNotFoundError as error:
        root = str(error.name).partition(".")[0]
        if root not in ROS:
            raise
        say_error(
            f"error: ROS 2 is not installed here ({root} is missing): source an installation "
            "(source /opt/ros/jazzy/setup.bash), or install its wheels (pip install "
            "'bo_tuner[jazzy]')"
        )
        sys.exit(EXIT_FAULT)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, SIGNALS)
    sys.exit(command.run(argv, interruption))


def _check_date() -> None:
    """Refuse a time of builds that NumPy and Matplotlib cannot read, which raise a `ValueError`."""
    text = os.environ.get(DATE, "0")
    try:
        time.gmtime(int(text))
    except (ValueError, OverflowError, OSError):
        say_error(f"error: {DATE}: expected whole seconds since 1970, found {text!r}")
        sys.exit(EXIT_USAGE)


def module_of(command: str) -> str:
    """Return the name of the module of a command; ``try`` cannot be the name of one."""
    return f"bo_tuner.cli.{command}{'_' if iskeyword(command) else ''}"


def _run_named(command: str) -> NoReturn:
    run(module_of(command), sys.argv[1:])


# One for each of the console scripts.
tune, init, check, try_, report, validate, replay, recompute, identify, apply, guard = (
    partial(_run_named, command) for command in COMMANDS
)
