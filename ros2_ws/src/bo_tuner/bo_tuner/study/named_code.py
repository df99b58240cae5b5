"""Python code that a study names as ``module:name``: foreign code, which may do anything."""

import contextlib
import importlib
import os
import signal
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from bo_tuner.text import one_line


class MovedError(RuntimeError):
    """Foreign code has changed the working directory, that of the whole process."""


def load(path: str, folder: str = "") -> Any:
    """Return what ``module:name`` names; raises whatever the import raises.

    Parameters
    ----------
    path
        What is named.
    folder
        Where modules are looked for last, beside those that Python finds anyway; empty for nowhere.
    """
    if folder and folder not in sys.path:
        # Last, so that a module there does not take the place of an installed one.
        sys.path.append(folder)
        importlib.invalidate_caches()
    module, _, name = path.partition(":")
    target: Any = importlib.import_module(module)
    for part in name.split("."):
        target = getattr(target, part)
    return target


def faults() -> tuple[type[BaseException], ...]:
    """Return the exceptions that foreign code may raise, for the ``except`` around it.

    `KeyboardInterrupt` is not among them where the user's Ctrl-C raises it.
    """
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        return (Exception, SystemExit)
    return (Exception, SystemExit, KeyboardInterrupt)


def told(error: BaseException) -> str:
    """Return in a line what foreign code has raised: its type and its message."""
    try:
        message = str(error)
    except faults():
        message = ""
    return one_line(f"{type(error).__name__}: {message}" if message else type(error).__name__)


@contextlib.contextmanager
def kept_in_place() -> Iterator[None]:
    """Raise `MovedError` if foreign code inside leaves another working directory, and go back."""
    before = _working_directory()
    try:
        yield
    finally:
        now = _working_directory()
        if now != before:
            os.chdir(before)
    # Not reached if foreign code has raised an error, which says more.
    if now != before:
        raise MovedError(f"changed the working directory to {now}")


def _working_directory() -> str:
    try:
        return str(Path.cwd())
    except OSError:
        return "one that is gone"
