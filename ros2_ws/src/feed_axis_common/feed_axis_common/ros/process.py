"""The life of a node's process: start, spin, and a clean end on SIGINT and SIGTERM."""

import os
import signal
import sys
import threading
from collections.abc import Callable
from types import FrameType

import rclpy
from rclpy.exceptions import InvalidParameterValueException
from rclpy.executors import Executor, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from feed_axis_common.errors import SettingsError
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
"""Time [s] that the middleware has to shut down."""


def make_executor() -> Executor:
    """Make the fastest executor that this rclpy has."""
    return SingleThreadedExecutor() if EventsExecutor is None else EventsExecutor()


def run(make_node: Callable[[], Node]) -> int:
    """Run one node until SIGINT or SIGTERM and return the exit code.

    rclpy's own handlers are not used: an idle ``rclpy.spin`` may hang on SIGTERM, and a second
    signal during the exit kills the process. Invalid parameters or arguments give one line on
    stderr and the code 2.
    """
    stop = False

    def request_stop(_signum: int, _frame: FrameType | None) -> None:
        nonlocal stop
        stop = True

    for signum in STOP_SIGNALS:
        signal.signal(signum, request_stop)
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
        deadline = threading.Timer(EXIT_TIMEOUT, os._exit, (0,))
        deadline.daemon = True
        deadline.start()
        executor.remove_node(node)
        node.destroy_node()
        executor.shutdown()
        rclpy.try_shutdown()
        deadline.cancel()
    return 0


def _refuse(reason: str) -> int:
    sys.stderr.write(f"error: {reason}\n")
    rclpy.try_shutdown()
    return EXIT_USAGE
