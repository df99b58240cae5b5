"""A reference over time as a file with comma-separated values."""

import csv
import hashlib
import io
import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from bo_tuner import maxima
from bo_tuner.codec import checks
from bo_tuner.errors import StudyError
from bo_tuner.interruption import content_of_file
from bo_tuner.numerics import profiles
from bo_tuner.numerics.arrays import Array

HOLD = "hold"


@dataclass(frozen=True)
class Table:
    """Values over time.

    Attributes
    ----------
    times
        Increasing times [s] (n,).
    values
        The value at each (n,).
    digest
        SHA-256 of the file.
    """

    times: Array
    values: Array
    digest: str

    def at(self, time: Array, *, hold: bool) -> Array:
        """Return the values (n,) at times (n,) [s]; beyond the table they are constant."""
        return profiles.interpolated(time, self.times, self.values, hold)


def read_table(path: Path, time: str, column: str) -> Table:
    """Read two columns of a file, by their names in its first line.

    Raises
    ------
    StudyError
        If the file cannot be read, does not have the columns, or a row of it has no finite number
        there or no later time than the one before; with the line.
    """
    try:
        content = content_of_file(path, maxima.FILE_BYTES)
    except OSError as error:
        raise _wrong(path, f"cannot be read: {error.strerror or error}") from None
    if len(content) > maxima.FILE_BYTES:
        raise _wrong(path, f"expected at most {maxima.FILE_BYTES / 1e6:g} MB")
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError:
        raise _wrong(path, "expected UTF-8 text") from None
    rows = np.array(list(_rows(path, text, time, column)))
    if len(rows) < 2:
        raise _wrong(path, f"expected at least 2 rows of numbers, found {len(rows)}")
    return Table(rows[:, 0], rows[:, 1], hashlib.sha256(content).hexdigest())


def _rows(path: Path, text: str, time: str, column: str) -> Iterator[tuple[float, float]]:
    reader = csv.reader(io.StringIO(text), skipinitialspace=True)
    last = -math.inf
    try:
        names = [name.strip() for name in next(reader, [])]
        places = [_place(path, names, name) for name in (time, column)]
        for row in reader:
            if not row:
                continue
            line = reader.line_num
            now, value = (_number(path, line, row, names, place) for place in places)
            if now <= last:
                raise _wrong(path, f"{time} {now:g} is not after {last:g}", line)
            last = now
            yield now, value
    except csv.Error as error:
        raise _wrong(path, str(error), reader.line_num) from None


def _place(path: Path, names: list[str], name: str) -> int:
    if name not in names:
        near = checks.suggestion(name, [item for item in names if item])
        raise _wrong(path, f"has no column '{name}' in its first line; {near}", 1)
    return names.index(name)


def _number(path: Path, line: int, row: list[str], names: list[str], place: int) -> float:
    shown = row[place].strip() if place < len(row) else ""
    try:
        value = float(shown)
    except ValueError:
        value = math.nan
    if not math.isfinite(value) or abs(value) > maxima.MAGNITUDE:
        raise _wrong(
            path, f"{names[place]}: expected a finite number, found {checks.quoted(shown)}", line
        )
    return value


def _wrong(path: Path, problem: str, line: int | None = None) -> StudyError:
    where = f"{path}:{line}" if line else f"{path}"
    return StudyError(f"{where}: {problem}", ("file",))
