"""Commands and nodes of the packages as processes of their own."""

import contextlib
import faulthandler
import json
import multiprocessing
import os
import re
import runpy
import signal
import subprocess
import sys
import tempfile
from multiprocessing import reduction
from unittest import mock

from waiting import DEADLINE

# The imports of a command or a node take longer than most runs of a small object. The server has
# them done when it forks; it serves this test process alone, and ends with it.
PRELOADED = ("tune", "init", "check", "report", "validate", "replay", "apply", "guard")
_SERVER = multiprocessing.get_context("forkserver")
_SERVER.set_forkserver_preload(
    [
        *(f"bo_tuner.cli.{name}" for name in PRELOADED),
        "milling_plant.node",
        "mpc_controller.node",
        "tuning_benchmark.command",
        # What these import only when it is needed, which is soon.
        "bo_tuner.figures.matplotlib_renderer",
        "rosbags.typesys.stores.ros2_jazzy",
        "scipy.stats",
    ]
)
# As all of them have it; the library reads it when it is loaded.
ONE_THREAD = {"OPENBLAS_NUM_THREADS": "1"}
STREAMS = ("stdout", "stderr")


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
    """``python -m package arguments`` in a folder, forked from a process with its imports.

    It is used like the `subprocess.Popen` of `start`. That one is for what happens before the
    command's first line: imports, signals in them, streams and environments that are odd.

    Parameters
    ----------
    folder
        Where it starts, and finds modules.
    package
        Whose ``__main__`` runs.
    env, without
        Changes of the environment.
    stdin
        A descriptor; nothing can be read without one.
    stdout, stderr
        Files or descriptors; what goes to none of them, `communicate` returns.
    start_new_session
        Whether it leads a process group.
    """

    def __init__(
        self,
        *arguments,
        folder,
        package="bo_tuner",
        env=None,
        without=(),
        stdin=None,
        stdout=None,
        stderr=None,
        start_new_session=False,
    ):
        self.args = [package, *map(str, arguments)]
        given = (stdout, stderr)
        # Closed when they are read, as pipes would be.
        self._said = [None if stream is not None else _temporary() for stream in given]
        self._answer = None
        output = [_Stream(file or stream) for file, stream in zip(self._said, given, strict=True)]
        input_ = None if stdin is None else _Stream(stdin)
        variables = environment(folder, without=without, **(env or {}))
        self._process = _SERVER.Process(
            target=_run_package,
            args=(self.args, str(folder), variables, input_, output, start_new_session),
        )
        with mock.patch.dict(os.environ, ONE_THREAD):
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
        if self._answer is None:
            self._process.close()
            self._answer = tuple(file and _content(file) for file in self._said)
        return self._answer

    def send_signal(self, signum):
        if self.poll() is None:
            # It may end in this moment.
            with contextlib.suppress(ProcessLookupError):
                os.kill(self.pid, signum)

    def terminate(self):
        self.send_signal(signal.SIGTERM)

    def kill(self):
        self.send_signal(signal.SIGKILL)


class ForkedGuard(Fork):
    """In place of the `subprocess.Popen` of a guard that a tuner starts."""

    def __init__(self, command, *, stdin, stdout, stderr, start_new_session, env):
        read, beats = os.pipe()
        heard, said = os.pipe()
        super().__init__(
            folder=os.getcwd(),  # noqa: PTH109
            package=command[-1],
            env=env,
            stdin=read,
            stdout=said,
            stderr=stderr,
            start_new_session=start_new_session,
        )
        os.close(read)
        os.close(said)
        self.stdin, self.stdout = os.fdopen(beats, "wb", buffering=0), os.fdopen(heard, "rb")


class _Stream:
    """A descriptor that the forked process gets, too."""

    def __init__(self, stream):
        self.descriptor = stream if isinstance(stream, int) else stream.fileno()

    def __getstate__(self):
        return reduction.DupFd(self.descriptor)

    def __setstate__(self, passed):
        self.descriptor = passed.detach()


def _temporary():
    return tempfile.NamedTemporaryFile("w+", encoding="utf-8")


def _content(file):
    with file:
        file.seek(0)
        return file.read()


def _run_package(command, folder, variables, input_, output, new_session):
    if new_session:
        os.setsid()
    if input_ is not None:
        os.dup2(input_.descriptor, 0)
        os.close(input_.descriptor)
        sys.stdin = os.fdopen(0, encoding="utf-8", closefd=False)
    for descriptor, (name, stream) in enumerate(zip(STREAMS, output, strict=True), start=1):
        os.dup2(stream.descriptor, descriptor)
        os.close(stream.descriptor)
        setattr(sys, name, os.fdopen(descriptor, "w", encoding="utf-8", closefd=False))
    faulthandler.enable()
    os.chdir(folder)
    os.environ.clear()
    os.environ.update(variables)
    # As of `python -m`: the folder, and what the environment says.
    sys.path[:] = [folder, *variables["PYTHONPATH"].split(os.pathsep)]
    sys.argv[:] = command
    try:
        runpy.run_module(command[0], run_name="__main__", alter_sys=True)
    finally:
        # Where an interpreter notes at its end what could not be written, multiprocessing does not.
        for name in STREAMS:
            getattr(sys, name).flush()


SEVERAL = """\
import json
import os
import runpy
import sys

# A thread of OpenBLAS that is busy at a fork lets the child wait for ever at its end.
os.environ["OPENBLAS_NUM_THREADS"] = "1"
import bo_tuner.cli.tune

for arguments in json.loads(sys.argv[1]):
    child = os.fork()
    if child == 0:
        sys.argv = ["bo_tuner", *arguments]
        runpy.run_module("bo_tuner", run_name="__main__", alter_sys=True)
    code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    if code != 0:
        sys.exit(f"{arguments}: exit code {code}")
"""


def several(*commands):
    """Arguments of an interpreter that runs commands one by one, each forked after the imports.

    For what Python takes at its start. It ends with the first that fails.
    """
    return [sys.executable, "-c", SEVERAL, json.dumps([[*map(str, each)] for each in commands])]


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


def rows(lines):
    """The rows of the table of trials among the lines that tune says."""
    return [line for line in lines if re.match(r" *\d+ ", line)]


def run(*arguments, **options):
    """Run a command, as a `Fork` with these options, to its end; its exit code and what it said."""
    return finish(Fork(*arguments, **options))
