"""Files of a run folder, opened and listed without following links, as it may be from anybody."""

import os
import stat
from pathlib import Path

from bo_tuner import maxima
from bo_tuner.errors import RunRecordError
from bo_tuner.trials import TUNING, Evaluation, Stage

LOGS = "log"
"""Folder in which nodes may leave what they like, as ``launch`` does a link to its latest log."""
BAGS = "bags"
"""Folder of the bags, each named by `bag_name`."""
ABORTS = "aborts"
"""Folder of the bags of runs that were aborted, by number."""
HELD_PARAMETERS = "held_parameters.json"
"""File beside the logs: parameters of attached nodes that a run holds."""
GUARD_RECORD = "guard.jsonl"
"""File beside the logs: the acts of guards, a line of JSON each."""
PREVIOUS_PARAMETERS = "previous_parameters.json"
"""File beside the logs: what attached nodes had, of what a run sets, before it set anything."""

KINDS = {
    stat.S_IFLNK: "a symbolic link",
    stat.S_IFIFO: "a named pipe",
    stat.S_IFSOCK: "a socket",
    stat.S_IFBLK: "a device",
    stat.S_IFCHR: "a device",
    stat.S_IFDIR: "a folder",
}


def bag_name(evaluation: Evaluation) -> str:
    """Name the bag that an evaluation belongs to: a trial, its check, or the validation."""
    if evaluation.stage is Stage.VALIDATION:
        return "validation"
    if evaluation.stage in TUNING:
        return trial_bag(evaluation.trial)
    return f"check_{evaluation.trial:04d}"


def trial_bag(number: int) -> str:
    """Name the bag of a trial without its checks."""
    return f"trial_{number:04d}"


def check_files(folder: Path) -> None:
    """Refuse a run folder in which anything is not a file or a folder.

    A link would lead reading and writing elsewhere, and a pipe would hold them up.
    """
    pending = [folder]
    while pending:
        current = pending.pop()
        is_log = current.name == LOGS
        try:
            with os.scandir(current) as entries:
                for entry in entries:
                    if entry.is_dir(follow_symlinks=False):
                        if not is_log:
                            pending.append(Path(entry.path))
                    elif entry.is_file(follow_symlinks=False):
                        continue
                    elif not is_log or entry.name.endswith(".log"):
                        mode = entry.stat(follow_symlinks=False).st_mode
                        raise RunRecordError(
                            f"{entry.path}: is {_kind(mode)}; expected only files and folders "
                            "in a run folder"
                        )
        except FileNotFoundError:
            # A run that is going on renames and deletes.
            continue
        except OSError as error:
            if isinstance(error, RunRecordError):
                raise
            raise RunRecordError(f"{current}: cannot be read: {error.strerror}") from error


def is_same_file(path: Path, known: os.stat_result) -> bool:
    """Whether a path still leads to the file or folder that it led to."""
    try:
        status = path.stat(follow_symlinks=False)
    except OSError:
        return False
    return (status.st_dev, status.st_ino) == (known.st_dev, known.st_ino)


def open_file(path: Path, flags: int) -> int:
    """Open a file and return its descriptor; a link, a pipe, a device or a folder is refused."""
    descriptor = os.open(path, flags | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC, 0o666)
    mode = os.fstat(descriptor).st_mode
    if not stat.S_ISREG(mode):
        os.close(descriptor)
        raise OSError(0, f"is {_kind(mode)}, no file", str(path))
    return descriptor


def read_text(path: Path) -> str:
    """Read a file of UTF-8 text."""
    with os.fdopen(open_file(path, os.O_RDONLY), "rb") as file:
        data = file.read(maxima.FILE_BYTES + 1)
    if len(data) > maxima.FILE_BYTES:
        raise OSError(0, f"is larger than {maxima.FILE_BYTES // 10**6} MB", str(path))
    return data.decode()


def _kind(mode: int) -> str:
    return KINDS.get(stat.S_IFMT(mode), "no file")
