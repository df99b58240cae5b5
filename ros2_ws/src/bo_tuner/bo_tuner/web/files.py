"""The files of a run that may be downloaded."""

import os
import stat
from pathlib import Path

from bo_tuner.storage.run_files import LOGS
from bo_tuner.storage.run_folder import JOURNAL

MOST_FILES = 500
"""Files that are listed of a run; one that records each trial has thousands."""


def files_of(run: Path, *beginnings: str) -> list[tuple[str, int]]:
    """Return path and size [byte] of the files in a run folder; links are none.

    With `beginnings`, only those whose paths begin with one of them.

    What matters most comes first: that in the folder itself. What nodes have printed is last.
    """
    found = []
    for folder, _, names in os.walk(run):
        for name in names:
            if name.startswith((".", f"{JOURNAL}-")):
                # Of the programs that work in it.
                continue
            path = Path(folder, name)
            if not str(path.relative_to(run)).startswith(beginnings or ""):
                continue
            try:
                kind = path.lstat()
            except OSError:
                # A run that is going on renames and deletes.
                continue
            if stat.S_ISREG(kind.st_mode):
                found.append((str(path.relative_to(run)), kind.st_size))
    found.sort(key=lambda item: (item[0].startswith(f"{LOGS}/"), item[0].count("/"), item[0]))
    return found[:MOST_FILES]


def size_in_words(size: int) -> str:
    """Format a size [byte]."""
    return f"{size / 1e6:.1f} MB" if size >= 1e6 else f"{-(-size // 1000)} kB"
