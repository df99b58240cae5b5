"""Commands of the packages as processes of their own."""

import os
import subprocess
import sys

from waiting import DEADLINE


def python_path(*folders):
    """Search path of a process that shall find what this one finds, and `folders` before it."""
    return os.pathsep.join([*map(str, folders), *sys.path])


def environment(*folders, without=(), **changes):
    """Environment of this process, with modules in `folders` to be found, and some changes."""
    inherited = {key: value for key, value in os.environ.items() if key not in without}
    return inherited | {"PYTHONPATH": python_path(*folders), "COLUMNS": "80"} | changes


def start(*arguments, folder, package="bo_tuner", env=None, without=(), **options):
    """Start ``python -m package arguments`` in a folder, whose modules it finds.

    `env` and `without` change its environment. Its output goes to pipes, as text, unless other
    `options` of `subprocess.Popen` say where.
    """
    return subprocess.Popen(
        [sys.executable, "-m", package, *map(str, arguments)],
        cwd=folder,
        env=environment(folder, without=without, **(env or {})),
        text=True,
        **({"stdout": subprocess.PIPE, "stderr": subprocess.PIPE} | options),
    )


def finish(process, deadline=DEADLINE):
    """Wait for the end of a process; returns its exit code and what it said."""
    try:
        out, err = process.communicate(timeout=deadline)
    except subprocess.TimeoutExpired:
        process.kill()
        process.communicate()
        raise
    assert "Traceback" not in out + err, err
    return process.returncode, out, err


def run(*arguments, folder, **options):
    """Run a command to its end; its exit code and what it said."""
    return finish(start(*arguments, folder=folder, **options))
