"""Ends the process at a time, whatever its threads wait for."""

import ctypes
import time

SIGEV_THREAD = 2
"""Of ``timer_create`` in glibc: at its time the timer calls a function in a thread of its own."""


class _Event(ctypes.Structure):
    """``struct sigevent`` of glibc."""

    _fields_ = (
        ("value", ctypes.c_void_p),
        ("signal", ctypes.c_int),
        ("notify", ctypes.c_int),
        ("function", ctypes.c_void_p),
        ("attributes", ctypes.c_void_p),
        ("padding", ctypes.c_char * 32),
    )


class _Times(ctypes.Structure):
    """``struct itimerspec``: period and first time, each in seconds and nanoseconds."""

    _fields_ = tuple(
        (name, ctypes.c_long)
        for name in ("period", "period_nanoseconds", "first", "first_nanoseconds")
    )


def exit_after(seconds: float, code: int) -> None:
    """End this process after a time, unless it has ended by then.

    A timer of Python would wait for the interpreter's lock, which rclpy holds while it destroys
    what a node has. This one is the system's, and calls ``_exit``: nothing is cleaned up.

    Parameters
    ----------
    seconds
        From now on.
    code
        Exit code.
    """
    libc = ctypes.CDLL(None)
    event = _Event(
        value=code, notify=SIGEV_THREAD, function=ctypes.cast(libc._exit, ctypes.c_void_p)
    )
    timer = ctypes.c_void_p()
    # Where the system has no timer left, the process is to end as well as it can without.
    if libc.timer_create(time.CLOCK_MONOTONIC, ctypes.byref(event), ctypes.byref(timer)) == 0:
        whole, rest = divmod(seconds, 1.0)
        times = _Times(first=int(whole), first_nanoseconds=int(rest * 1e9))
        libc.timer_settime(timer, 0, ctypes.byref(times), None)
