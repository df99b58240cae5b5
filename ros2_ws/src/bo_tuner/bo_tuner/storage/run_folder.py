"""The folder of a run: the study as run, the journal, and what came out of it."""

import contextlib
import fcntl
import json
import os
import shlex
import shutil
import weakref
from collections.abc import Iterable, Mapping
from datetime import datetime
from pathlib import Path
from typing import Self

from bo_tuner.codec.writing import to_json
from bo_tuner.errors import OutputError
from bo_tuner.storage.atomic import (
    LEFTOVERS,
    remove_leftovers,
    temporary_path,
    write_atomically,
)
from bo_tuner.storage.parameter_file import node_values, sent_values, to_yaml
from bo_tuner.storage.run_files import (
    HELD_PARAMETERS,
    LOGS,
    PREVIOUS_PARAMETERS,
    is_same_file,
    open_file,
)
from bo_tuner.study.study import Study
from bo_tuner.study.study_file import study_to_yaml
from bo_tuner.trials import Value

LATEST = "latest"
LOCK = ".lock"
STUDY = "study.yaml"
JOURNAL = "journal.sqlite"
SIMULATION = "simulation.sqlite"
"""Trials of a simulation that the run knows, as a journal."""
BEST = "best.yaml"
SUMMARY = "summary.json"
RECORDING = "recording.json"
REPORT = "report.html"


def how_to_resume(path: Path) -> str:
    """Return in a few words how the run in a folder is continued."""
    return f"resume it with: {shlex.join(['tune', '--resume', str(path)])}"


class RunFolder:
    """The folder of a run, which this process alone works in until it is closed."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._process = os.getpid()
        try:
            self._identity = path.stat()
            # The lock ends with the process, however that ends.
            self._lock = open_file(path / LOCK, os.O_RDWR | os.O_CREAT)
        except OSError as error:
            raise OutputError(f"{path}: cannot write there: {error.strerror}") from error
        self._release = weakref.finalize(self, _release, self._lock, self._process)
        try:
            fcntl.flock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            holder = os.read(self._lock, 20).decode("ascii", "replace").strip()
            os.close(self._lock)
            self._release.detach()
            if holder == str(self._process):
                raise OutputError(
                    f"{path}: this process is using this run folder already; close what was "
                    "opened before, such as by tuner.close()"
                ) from None
            by = f" (process {holder})" if holder.isdigit() else ""
            raise OutputError(f"{path}: another process is using this run folder{by}") from None
        try:
            os.ftruncate(self._lock, 0)
            os.write(self._lock, str(os.getpid()).encode())
            remove_leftovers(path.rglob(LEFTOVERS))
        except OSError as error:
            self.close()
            raise OutputError(f"{path}: cannot write there: {error.strerror}") from error

    @classmethod
    def create(cls, output: Path, study: Study) -> Self:
        """Make ``<output>/<study>-<date-time>``, with a number behind if that exists."""
        stamp = datetime.now().strftime("%Y%m%d-%H%M%S")
        try:
            output.mkdir(parents=True, exist_ok=True)
            _check_latest(output / LATEST)
            folder = cls(_new_folder(output / f"{study.name}-{stamp}"))
            folder.log.mkdir()
            folder.write_study(study)
        except OutputError:
            raise
        except OSError as error:
            raise OutputError(f"{output}: cannot write runs there: {error.strerror}") from error
        return folder

    def check(self) -> None:
        """Refuse to go on in a folder that is no longer this process's own."""
        self.check_process()
        if not is_same_file(self.path.resolve(), self._identity):
            raise OutputError(f"{self.path}: the run folder was deleted or moved during the run")
        if not is_same_file(self.path / LOCK, os.fstat(self._lock)):
            raise OutputError(f"{self.path / LOCK}: was deleted or replaced during the run")

    @property
    def forked(self) -> bool:
        """Whether this is a child of the process that works in the folder."""
        return os.getpid() != self._process

    def check_process(self) -> None:
        """Refuse to go on in a child of the process that works in it; raises `OutputError`."""
        if self.forked:
            raise OutputError(
                f"{self.path}: process {self._process} is using this run folder, and this one was "
                "forked from it; ask and tell there"
            )

    def close(self) -> None:
        """Let other processes work in the folder."""
        self._release()

    def discard(self) -> None:
        """Remove the folder of a run that did not start; what its nodes printed stays.

        Does nothing if the run has a journal.
        """
        if self.journal.exists():
            return
        # The tuner's own log of ROS is named after this process.
        own = f"_{os.getpid()}_"
        printed = [
            path
            for path in self.log.rglob("*")
            if path.is_file()
            and path.stat().st_size
            and path.name not in (HELD_PARAMETERS, PREVIOUS_PARAMETERS)
            and own not in path.name
        ]
        with contextlib.suppress(OSError):
            if not printed:
                shutil.rmtree(self.log)
            for name in (STUDY, SIMULATION, LOCK):
                (self.path / name).unlink(missing_ok=True)
            self.path.rmdir()

    @property
    def log(self) -> Path:
        """Folder for what the nodes print."""
        return self.path / LOGS

    @property
    def journal(self) -> Path:
        """File of the journal."""
        return self.path / JOURNAL

    def link_latest(self) -> None:
        """Let ``latest``, beside the folder, point to it."""
        target = self.path.with_name(LATEST)
        link = temporary_path(target)
        _check_latest(target)
        remove_leftovers(target.parent.glob(LEFTOVERS))
        try:
            link.unlink(missing_ok=True)
            link.symlink_to(self.path.name)
            link.replace(target)
        except OSError as error:
            link.unlink(missing_ok=True)
            raise OutputError(f"{target}: cannot point to the run: {error.strerror}") from error

    def write_parameters(
        self, study: Study, parameters: Mapping[str, Value], notes: Iterable[str] = ()
    ) -> Path:
        """Write ``best.yaml``, which ``--params-file`` takes, and return its path.

        The notes, a line each, become comments ahead of the values. Raises `OutputError` if the
        file cannot be written.
        """
        told = [*notes, *sent_values(study, parameters)]
        return write_atomically(self.path / BEST, to_yaml(node_values(study, parameters), told))

    def write_study(self, study: Study) -> Path:
        """Write ``study.yaml``, and return its path; raises `OutputError` if that fails."""
        return write_atomically(self.path / STUDY, study_to_yaml(study))

    def write_json(self, name: str, content: Mapping[str, object]) -> Path:
        """Write a file of JSON, with null for what is not a number, and return its path."""
        self.check()
        return write_json(self.path / name, content)


def _release(lock: int, process: int) -> None:
    """Give up a lock, which children that were forked meanwhile hold as well."""
    if os.getpid() == process:
        fcntl.flock(lock, fcntl.LOCK_UN)
    os.close(lock)


def write_json(path: Path, content: Mapping[str, object]) -> Path:
    """Write a file of JSON, with null for what is not a number, also to a folder not held open."""
    text = json.dumps(to_json(content), indent=2, allow_nan=False)
    return write_atomically(path, text + "\n")


def _check_latest(path: Path) -> None:
    """Refuse to replace what no run has made: a file, a folder, or a link that leads elsewhere."""
    if os.path.lexists(path) and not (path.is_symlink() and len(path.readlink().parts) == 1):
        raise OutputError(f"{path}: cannot point to the run: it is no link to a run beside it")


def _new_folder(path: Path) -> Path:
    """Make `path`, or the first of ``<path>-2``, ``<path>-3``... that does not exist yet."""
    folder = path
    number = 1
    while True:
        # No test ahead of it: of two runs that begin in the same second only one makes the folder.
        try:
            folder.mkdir()
        except FileExistsError:
            number += 1
            folder = path.with_name(f"{path.name}-{number}")
        else:
            return folder
