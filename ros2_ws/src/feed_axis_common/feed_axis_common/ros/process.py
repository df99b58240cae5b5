"""The life of a node's process: start, spin, and a clean end on SIGINT and SIGTERM."""

import os
import signal
import sys
import threading
from collections.abc import Callable, Sequence
from pathlib import Path
from types import FrameType

import rclpy
from rclpy.exceptions import InvalidParameterValueException
from rclpy.executors import Executor, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import remove_ros_args

from feed_axis_common.errors import SettingsError
from feed_axis_common.exit_deadline import exit_after
from feed_axis_common.parameters import Specification
from feed_axis_common.signals import STOP_SIGNALS

try:
    # Experimental in Jazzy but 1.5 to 7 times faster; only its spin_once is dependable.
    from rclpy.experimental import EventsExecutor
except ImportError:
    EventsExecutor = None  # type: ignore[assignment]

EXIT_USAGE = 2
SPIN_PERIOD = 0.1
"""Longest time [s] from a signal to the end of the loop."""
EXIT_TIMEOUT = 5.0
"""Time [s] that the middleware has to return from a spin, and again to shut down."""


def make_executor() -> Executor:
    """Make the fastest executor that this rclpy has."""
    return SingleThreadedExecutor() if EventsExecutor is None else EventsExecutor()


def run(make_node: Callable[[], Node], what: str, parameters: Sequence[Specification]) -> int:
    """Run one node until SIGINT or SIGTERM and return the exit code.

    rclpy's own handlers are not used: an idle ``rclpy.spin`` may hang on SIGTERM, and a second
    signal during the exit kills the process. Invalid parameters or arguments give one line on
    stderr and the code 2. A node that ignored what does not follow ``--ros-args`` would start with
    its defaults where a parameter file was meant.

    Parameters
    ----------
    make_node
        Makes the node.
    what
        What the node does, in a line for ``--help``.
    parameters
        Of the node, for ``--help``.
    """
    code = _answer_arguments(what, parameters)
    if code is not None:
        return code
    stop = False

    def request_stop(_signum: int, _frame: FrameType | None) -> None:
        nonlocal stop
        stop = True

    for signum in STOP_SIGNALS:
        signal.signal(signum, request_stop)
    _watch_for_stop()
    try:
        rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
        node = make_node()
    except SettingsError as error:
        return _refuse(str(error))
    except (RuntimeError, ValueError, InvalidParameterValueException) as error:
        # From rclpy, for bad arguments, parameter files or values; the text may have several lines.
        return _refuse(f"cannot start the node: {str(error).splitlines()[0]}")
    executor = make_executor()
    executor.add_node(node)
    try:
        while not stop:
            try:
                executor.spin_once(timeout_sec=SPIN_PERIOD)
            except Exception as error:
                if not rclpy.ok():
                    raise
                # One bad message must not end the node, whether our code or rclpy fails on it.
                node.get_logger().error(f"a message was dropped: {error!r}")
    finally:
        for signum in STOP_SIGNALS:
            signal.signal(signum, signal.SIG_IGN)
        # On rare occasions the middleware hangs in its shutdown.
        exit_after(EXIT_TIMEOUT, 0 if stop else 1)
        executor.remove_node(node)
        # Before the node: what it has would else be destroyed within the executor, as that lets go
        # of it, where the middleware has been seen to hang.
        executor.shutdown()
        node.destroy_node()
        rclpy.try_shutdown()
    return 0


def _watch_for_stop() -> None:
    """End the process if it does not take notice of a signal.

    On rare occasions the middleware does not return from a spin, and Python calls the handler of a
    signal only after that. That one has come is written to a pipe at once.
    """
    receiver, sender = os.pipe()
    os.set_blocking(sender, False)
    signal.set_wakeup_fd(sender, warn_on_full_buffer=False)

    def wait() -> None:
        while os.read(receiver, 1)[0] not in STOP_SIGNALS:
            pass
        exit_after(EXIT_TIMEOUT, 0)

    threading.Thread(target=wait, daemon=True).start()


def _answer_arguments(what: str, parameters: Sequence[Specification]) -> int | None:
    """Return the exit code if the arguments ask for help or are refused; None for a node to run."""
    command = Path(sys.argv[0]).name
    try:
        arguments = remove_ros_args(sys.argv)[1:]
    except RuntimeError as error:
        return _refuse(f"cannot start the node: {str(error).splitlines()[0]}")
    if not arguments:
        return None
    if arguments[0] in ("-h", "--help"):
        signal.signal(signal.SIGPIPE, signal.SIG_DFL)  # `--help | head` is no error
        print(_help(command, what, parameters))
        return 0
    return _refuse(
        f"unexpected argument {arguments[0]!r}; expected ROS arguments only, "
        f"such as: {command} --ros-args --params-file FILE"
    )


def _help(command: str, what: str, parameters: Sequence[Specification]) -> str:
    """Return the text of ``--help``."""
    width = max(len(spec.name) for spec in parameters)
    lines = [
        f"usage: {command} [--ros-args [-p NAME:=VALUE] [--params-file FILE] [-r __ns:=/NAME]]",
        "",
        what,
        "",
        "parameters:",
        *(f"  {spec.name:{width}}  {spec.description}" for spec in parameters),
    ]
    return "\n".join(lines)


def _refuse(reason: str) -> int:
    sys.stderr.write(f"error: {reason}\n")
    rclpy.try_shutdown()
    return EXIT_USAGE
