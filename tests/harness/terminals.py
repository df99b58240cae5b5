"""Terminals that can be read and typed into, and outputs that take nothing."""

import contextlib
import io
import os
import pty
import select
import subprocess

from rich.console import Console
from waiting import DEADLINE


def console(width=80, *, terminal=False):
    """A console that writes to a string, on a terminal of a width or to a file."""
    return Console(
        file=io.StringIO(),
        width=width,
        force_terminal=terminal,
        markup=False,
        emoji=False,
        highlight=False,
    )


@contextlib.contextmanager
def gone(kind):
    """A descriptor that takes no output: of a ``full`` device or a ``pipe`` that nobody reads."""
    if kind == "full":
        output = os.open("/dev/full", os.O_WRONLY)
    else:
        reading, output = os.pipe()
        os.close(reading)
    try:
        yield output
    finally:
        os.close(output)


def converse(command, exchanges, code=0, **options):
    """Run a command on a terminal, and answer what it asks; all that it said until the last one.

    Each exchange is a text that is waited for, and the answer. The command ends with `code`.
    """
    leader, follower = pty.openpty()
    process = subprocess.Popen(command, stdin=follower, stdout=follower, stderr=follower, **options)
    os.close(follower)
    said = ""
    try:
        for question, answer in exchanges:
            begin = len(said)
            while question not in said[begin:]:
                assert select.select([leader], [], [], DEADLINE)[0], said
                said += os.read(leader, 4096).decode()
            os.write(leader, answer() if callable(answer) else answer)
        assert process.wait(DEADLINE) == code, said
    finally:
        process.kill()
        process.wait()
        os.close(leader)
    return said
