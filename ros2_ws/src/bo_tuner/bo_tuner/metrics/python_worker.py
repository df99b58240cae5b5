"""The process in which the functions of a study compute metrics; `PythonProcess` is its other end.

It receives ``(path, signals)`` over a socket, and answers ``(value, problem)``: a number and an
empty text, or None and what was wrong, in words. Without signals it only loads the function.
"""

import os
import signal
import sys
from collections.abc import Mapping, Sequence
from multiprocessing.connection import Connection
from typing import Any

import numpy as np

from bo_tuner.asked_process import serve
from bo_tuner.codec import checks
from bo_tuner.metrics.stored_messages import decoded
from bo_tuner.numerics.arrays import Array
from bo_tuner.study import named_code

Passed = tuple[Array, Array | tuple[str, Sequence[bytes]]]
"""Times (n,) [s] and values (n,) of a signal; of whole messages their type and bytes (n)."""
Signals = Mapping[str, Passed]
"""The signals by their names."""


def answer(question: tuple[str, Signals | None]) -> tuple[float | None, str]:
    """Load a function, or have it compute."""
    path, signals = question
    return _loaded(path) if signals is None else _computed(path, signals)


def _loaded(path: str) -> tuple[None, str]:
    try:
        with named_code.kept_in_place():
            function = named_code.load(path)
    except named_code.faults() as error:
        return None, f"cannot import {path}: {named_code.described(error)}"
    return None, "" if callable(function) else f"expected a function, found {checks.show(function)}"


def _computed(path: str, signals: Signals) -> tuple[float | None, str]:
    try:
        with named_code.kept_in_place():
            value = named_code.load(path)(
                {name: (time, _read(content)) for name, (time, content) in signals.items()}
            )
    except named_code.MovedError as error:
        return None, str(error)
    except named_code.faults() as error:
        return None, f"raised {named_code.described(error)}"
    if isinstance(value, bool) or not isinstance(value, (int, float, np.integer, np.floating)):
        return None, f"returned {checks.show(value)}, expected a number"
    try:
        return float(value), ""
    except named_code.faults() as error:
        name = type(value).__name__
        return None, f"returned a {name} that is no number: {named_code.described(error)}"


def _read(content: Array | tuple[str, Sequence[bytes]]) -> Any:
    """Return values as they are, and whole messages as objects with their fields."""
    return decoded(*content) if isinstance(content, tuple) else content


if __name__ == "__main__":
    # The output of a command must not have in it what the functions print.
    os.dup2(2, 1)
    # Ctrl-C reaches only the tuner, which ends this process.
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    serve(Connection(int(sys.argv[1])), answer)
