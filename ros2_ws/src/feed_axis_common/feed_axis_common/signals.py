"""What SIGINT and SIGTERM do before a node is there to shut down.

A node's imports take most of its start, and Python answers a signal in them with a traceback or
the exit code of a kill. So this module imports nothing heavy, and a node's ``main`` calls
`exit_on_stop_signal` ahead of its imports; `feed_axis_common.ros.process` takes over from there.
"""

import os
import signal

STOP_SIGNALS = (signal.SIGINT, signal.SIGTERM)


def exit_on_stop_signal() -> None:
    """Let SIGINT and SIGTERM end the process at once, with exit code 0."""
    for signum in STOP_SIGNALS:
        # Not by an exception, which the code that is interrupted might catch.
        signal.signal(signum, lambda _signum, _frame: os._exit(0))
