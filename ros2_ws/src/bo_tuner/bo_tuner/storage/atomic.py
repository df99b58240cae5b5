"""Writing a file so that it holds its old content or its new one, whatever happens meanwhile."""

import contextlib
import errno
import os
import re
import stat
from collections.abc import Iterable, Iterator
from pathlib import Path

from bo_tuner.errors import OutputError

LEFTOVERS = ".*.new"
"""Pattern of the names of `temporary_path`, for a glob."""
_TEMPORARY = re.compile(r"\..+\.([0-9]{1,9})\.new")


def temporary_path(path: Path) -> Path:
    """Return where this process writes a file before it takes the place of `path`."""
    return path.with_name(f".{path.name}.{os.getpid()}.new")


def remove_leftovers(paths: Iterable[Path]) -> None:
    """Remove those of `paths` that killed processes have left half written.

    What a process that runs may be writing is left alone, and so is what is no file or link.
    """
    for path in paths:
        match = _TEMPORARY.fullmatch(path.name)
        if match and not _runs(int(match[1])):
            with contextlib.suppress(OSError):
                path.unlink()


def _runs(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except OSError:
        # The process of another user.
        return True
    return True


@contextlib.contextmanager
def writing(path: Path) -> Iterator[None]:
    """Turn any other `OSError` into an `OutputError`: `path` cannot be written."""
    try:
        yield
    except OutputError:
        raise
    except OSError as error:
        raise OutputError(f"{path}: cannot be written: {error.strerror or error}") from error


def write_atomically(path: Path, content: str | bytes, like: Path | None = None) -> Path:
    """Replace a file, or create it, in one step that survives a power failure; return its path.

    A temporary file in the same folder is written, synchronized and renamed, and the folder is
    synchronized. A file that has this content already is left alone.
    """
    data = content.encode("utf-8", "replace") if isinstance(content, str) else content
    with writing(path):
        if not path.name:
            raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR))
        temporary = temporary_path(path)
        if _is_regular(path) and path.read_bytes() == data:
            return path
        try:
            # A killed process of the same number may have left one.
            temporary.unlink(missing_ok=True)
            flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW
            mode = 0o666 if like is None else 0o600
            with open(os.open(temporary, flags, mode), "wb") as file:  # noqa: PTH123
                if like is not None:
                    _make_alike(file.fileno(), like.stat())
                file.write(data)
                file.flush()
                os.fsync(file.fileno())
            temporary.replace(path)
        finally:
            temporary.unlink(missing_ok=True)
        synchronize(path.parent)
    return path


def _make_alike(descriptor: int, wanted: os.stat_result) -> None:
    """Give an open file an owner, a group and a mode."""
    own = os.fstat(descriptor)
    if (own.st_uid, own.st_gid) != (wanted.st_uid, wanted.st_gid):
        os.fchown(descriptor, wanted.st_uid, wanted.st_gid)
    os.fchmod(descriptor, stat.S_IMODE(wanted.st_mode))


def synchronize(folder: Path) -> None:
    """Make the names in a folder durable."""
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _is_regular(path: Path) -> bool:
    """Return whether there is a regular file; False if there is nothing."""
    try:
        mode = path.lstat().st_mode
    except FileNotFoundError:
        return False
    if stat.S_ISLNK(mode):
        raise OSError("expected a file, found a symbolic link")
    if stat.S_ISDIR(mode):
        raise OSError("Is a directory")
    if not stat.S_ISREG(mode):
        raise OSError("expected a regular file")
    return True
