"""The file of a campaign: one line of JSON for each finished task, safe against a kill.

A line is on the disk before its task counts as done. A line torn by a kill is cut off when the file
is opened again, and its task runs once more.
"""

import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Self

from bo_tuner.errors import OutputError
from bo_tuner.storage.atomic import writing


class Records:
    """Records of finished tasks; a context manager, inside which records can be added.

    Parameters
    ----------
    path
        The file; created if missing.
    versions
        Version of each task of the campaign by its name. Records of other tasks stay in the file
        and are ignored.
    any_version
        Accept records of other versions, too, for reading only.

    Raises
    ------
    OutputError
        If the file cannot be read, or holds a record of another version of one of the tasks.
    """

    def __init__(
        self, path: Path, versions: Mapping[str, str], *, any_version: bool = False
    ) -> None:
        self._path = path
        self._file: Any = None
        self.done: dict[str, dict[str, Any]] = {}
        content = _read(path)
        self._size = len(content)
        # What follows the last newline is a torn line.
        self._whole = content.rfind(b"\n") + 1
        for number, line in enumerate(content[: self._whole].splitlines(), start=1):
            try:
                record = json.loads(line)
                name, version = record["task"], record["version"]
            except (ValueError, KeyError, TypeError):
                raise OutputError(f"{path}: line {number} is not the record of a task") from None
            if name not in versions:
                continue
            if version != versions[name] and not any_version:
                raise OutputError(
                    f"{path}: holds {name} of another version of the code or the experiment "
                    f"({version}, now {versions[name]}); results of two versions do not mix: "
                    "remove the file, or choose another folder for the records"
                )
            self.done[name] = record

    def __enter__(self) -> Self:
        """Open the file for further records, without a torn end.

        Raises
        ------
        OutputError
            If it cannot be written, or another campaign has written to it since it was read.
        """
        with writing(self._path):
            self._path.parent.mkdir(parents=True, exist_ok=True)
            self._file = self._path.open("ab")
            unchanged = self._file.tell() == self._size
            if unchanged:
                self._file.truncate(self._whole)
        if not unchanged:
            self._file.close()
            raise OutputError(
                f"{self._path}: another campaign has written to it; let that one end, or choose "
                "another folder for the records"
            )
        return self

    def __exit__(self, *_: object) -> None:
        """Close the file."""
        self._file.close()

    def add(self, record: Mapping[str, Any]) -> None:
        """Write a record through to the disk.

        Raises
        ------
        OutputError
            If it cannot be written, for example because the disk is full.
        """
        line = json.dumps(record, allow_nan=False, separators=(",", ":")) + "\n"
        with writing(self._path):
            self._file.write(line.encode())
            self._file.flush()
            os.fsync(self._file.fileno())
        # As it will be read again, so that a resumed campaign sees the same.
        self.done[str(record["task"])] = json.loads(line)


def _read(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except FileNotFoundError:
        return b""
    except OSError as error:
        raise OutputError(f"{path}: cannot be read: {error.strerror}") from error
