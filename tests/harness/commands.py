"""Commands of the packages as processes of their own."""

import multiprocessing
import os
import runpy
import subprocess
import sys
import tempfile

from waiting import DEADLINE

# The imports of a command take longer than most runs of a small object. The server has them done
# when it forks; it serves this test process alone, and ends with it.
_SERVER = multiprocessing.get_context("forkserver")
_SERVER.set_forkserver_preload(
    [
        *(f"bo_tuner.cli.{name}" for name in ("tune", "report", "validate", "replay", "apply")),
        # What these import only when it is needed, which is soon.
        "plotly",
        "scipy.stats",
    ]
)


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


class Fork:
    """``python -m bo_tuner arguments`` in a folder, forked from a process with its imports.

    It is used like the `subprocess.Popen` of `start`. That one is for what happens before the
    command's first line or after its last: imports, signals in them, streams that are odd.
    """

    def __init__(self, *arguments, folder, env=None, without=()):
        self.args = [str(argument) for argument in arguments]
        # Closed when they are read, as pipes would be.
        self._output = [
            tempfile.NamedTemporaryFile("r", encoding="utf-8")  # noqa: SIM115
            for _ in range(2)
        ]
        variables = environment(folder, without=without, **(env or {}))
        self._process = _SERVER.Process(
            target=_run_command,
            args=(self.args, str(folder), variables, [file.name for file in self._output]),
        )
        self._process.start()
        self.pid = self._process.pid
        self.returncode = None

    def poll(self):
        if self.returncode is None:
            self.returncode = self._process.exitcode
        return self.returncode

    def wait(self, timeout=None):
        if self.returncode is None:
            self._process.join(timeout)
        if self.poll() is None:
            raise subprocess.TimeoutExpired(self.args, timeout)
        return self.returncode

    def communicate(self, timeout=None):
        self.wait(timeout)
        said = []
        for file in self._output:
            said.append(file.read())
            file.close()
        self._process.close()
        return tuple(said)

    def send_signal(self, signum):
        if self.poll() is None:
            os.kill(self.pid, signum)

    def kill(self):
        if self.poll() is None:
            self._process.kill()


def _run_command(arguments, folder, variables, output):
    for descriptor, path in enumerate(output, start=1):
        file = os.open(path, os.O_WRONLY | os.O_APPEND)
        os.dup2(file, descriptor)
        os.close(file)
    os.chdir(folder)
    os.environ.clear()
    os.environ.update(variables)
    # As of `python -m`: the folder, and what the environment says.
    sys.path[:] = [folder, *variables["PYTHONPATH"].split(os.pathsep)]
    sys.argv[:] = ["bo_tuner", *arguments]
    runpy.run_module("bo_tuner", run_name="__main__", alter_sys=True)


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


def run(*arguments, **options):
    """Run a command, as a `Fork` with these options, to its end; its exit code and what it said."""
    return finish(Fork(*arguments, **options))
