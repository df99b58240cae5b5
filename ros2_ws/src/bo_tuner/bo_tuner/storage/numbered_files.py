"""Files of a folder that are numbered, as ``0001.json``."""

import re
from pathlib import Path

_NAME = re.compile(r"(\d{4,9})\.json", re.ASCII)


def next_number(directory: Path) -> int:
    """Return the number after that of the latest file, from 1."""
    names = [path.name for path in directory.iterdir()] if directory.is_dir() else []
    return 1 + max((int(match[1]) for name in names if (match := _NAME.fullmatch(name))), default=0)


def numbered(directory: Path, number: int) -> Path:
    """Return the path of the file with a number."""
    return directory / f"{number:04d}.json"
