"""A console of the tuner's commands whose output can be read."""

import io

from rich.console import Console


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
