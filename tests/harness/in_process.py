"""Commands in this process."""

import sys
from contextlib import contextmanager


class Uninterrupted:
    """In place of the interruption by signals."""

    signum = None

    def check(self):
        pass

    def ignore(self):
        pass

    def keep_running(self):
        pass


def call(command, capsys, *arguments):
    """Run the command of a module; returns its exit code, output and errors."""
    try:
        with _own_objects():
            code = command.run([str(argument) for argument in arguments], Uninterrupted())
    except SystemExit as end:
        code = end.code
    out, err = capsys.readouterr()
    assert "Traceback" not in err
    return code, out, err


def complaint(command, capsys, *arguments, code=2, warnings=0):
    """Run a command that says no more than some warnings and its error; returns the error."""
    found, out, err = call(command, capsys, *arguments)
    assert (found, out) == (code, ""), err
    *warned, line = err.splitlines()
    assert len(warned) == warnings, err
    assert line.startswith("error: ")
    return line


@contextmanager
def _own_objects():
    """Let a command import the `axis` of its folder, not one of that name from another test."""
    path = list(sys.path)
    sys.modules.pop("axis_objects", None)
    try:
        yield
    finally:
        sys.path[:] = path
        sys.modules.pop("axis_objects", None)
