"""Standard input, output and error of a command, whatever state they are in."""

import contextlib
import io
import os
import select
import sys
from io import TextIOWrapper
from typing import TextIO

from bo_tuner.interruption import Interruption
from bo_tuner.text import one_line

STREAMS = (("stdin", "r"), ("stdout", "w"), ("stderr", "w"))

_closed: set[str] = set()


def open_streams() -> None:
    """Open what was closed (``>&-``) on /dev/null.

    Else the next file that is opened, such as a journal, would take its descriptor, and with it
    whatever a library prints.
    """
    for descriptor, (name, mode) in enumerate(STREAMS):
        try:
            os.fstat(descriptor)
        except OSError:
            # The lowest free descriptor is this one.
            os.open(os.devnull, os.O_RDWR)
            _closed.add(name)
            setattr(sys, name, os.fdopen(descriptor, mode, encoding="utf-8"))
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, TextIOWrapper):
            # A character that the terminal cannot show becomes a question mark, not an error.
            stream.reconfigure(errors="replace")


def output_was_closed() -> bool:
    """Whether standard output was closed when the command began, so that nobody sees it."""
    return "stdout" in _closed


def say_error(text: str) -> None:
    """Write a line to standard error, if that is still there."""
    with contextlib.suppress(OSError, ValueError):
        sys.stderr.write(f"{one_line(text)}\n")
        sys.stderr.flush()


def prompt(question: str) -> None:
    """Show a question; what is typed follows in its line."""
    sys.stdout.write(question)
    sys.stdout.flush()


def typed(seconds: float) -> str | None:
    """Return the line that the user types, without its end; None if there is none in a time [s]."""
    # A read would continue after a signal, so wait until there is input.
    if not select.select([sys.stdin], [], [], seconds)[0]:
        return None
    if not (line := sys.stdin.readline()):
        raise EOFError
    return line.strip()


def ask(question: str, interruption: Interruption) -> str | None:
    """Return the line that the user answers, without its end; None at the end of the input."""
    prompt(question)
    try:
        while (line := typed(0.1)) is None:
            interruption.check()
    except EOFError:
        return None
    return line


def confirmed(question: str, interruption: Interruption) -> bool:
    """Return whether the user answers y or yes."""
    return (ask(question, interruption) or "").lower() in ("y", "yes")


def discard_output() -> None:
    """Give up what cannot be written, so that the interpreter does not try again at its end."""
    for stream in (sys.stdout, sys.stderr):
        if not _can_flush(stream):
            with contextlib.suppress(OSError, io.UnsupportedOperation):
                nowhere = os.open(os.devnull, os.O_WRONLY)
                os.dup2(nowhere, stream.fileno())
                os.close(nowhere)


def _can_flush(stream: TextIO) -> bool:
    try:
        stream.flush()
    except (OSError, ValueError):
        return False
    return True
