"""Files of a folder that are numbered, as ``0001.json``."""

import re
from pathlib import Path

_NAME = re.compile(r"\d{4,9}\.json", re.ASCII)


def numbered_paths(directory: Path) -> list[Path]:
    """Return the paths of the numbered files, the latest first."""
    paths = directory.iterdir() if directory.is_dir() else ()
    numbered = [path for path in paths if _NAME.fullmatch(path.name)]
    return sorted(numbered, key=_number, reverse=True)


def next_number(directory: Path) -> int:
    """Return the number after that of the latest file, from 1."""
    return 1 + max(map(_number, numbered_paths(directory)), default=0)


def numbered_path(directory: Path, number: int) -> Path:
    """Return the path of the file with a number."""
    return directory / f"{number:04d}.json"


def _number(path: Path) -> int:
    return int(path.stem)
