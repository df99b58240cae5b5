"""Locks that hold for all processes of a user on this machine."""

import fcntl
import os
import tempfile
from pathlib import Path
from typing import IO

from bo_tuner.errors import BackendError
from bo_tuner.storage.run_files import open_file


def host_lock(name: str) -> IO[str] | None:
    """Take a lock by its name; None if another process has it.

    Closing the file gives it back, and so does the end of the process.
    """
    path = Path(tempfile.gettempdir()) / f"bo_tuner-{os.getuid()}-{name}.lock"
    try:
        # Not what anybody may have put there instead: the folder is open to all.
        handle = os.fdopen(open_file(path, os.O_WRONLY | os.O_APPEND | os.O_CREAT), "a")
    except OSError as error:
        raise BackendError(f"{path}: cannot be locked: {error.strerror}") from error
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        handle.close()
        return None
    return handle
