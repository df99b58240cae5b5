"""What a journal needs before a run goes on: one that is damaged is made whole.

A trial that was lost at its end is withdrawn, to be run again.

The new journal stands beside the damaged one until it takes its place. A kill in between loses
nothing: the next call finishes what was begun.
"""

import sqlite3
import struct
from contextlib import closing
from dataclasses import replace
from pathlib import Path

from bo_tuner.errors import JournalError
from bo_tuner.storage.atomic import synchronize, write_atomically
from bo_tuner.storage.journal import create_journal
from bo_tuner.storage.journal_reader import JournalContent, read_journal
from bo_tuner.text import counted

_WAL_HEADER = struct.Struct(">IIIIIIII")
_FRAME_HEADER = struct.Struct(">IIIIII")


def salvage(path: Path) -> tuple[JournalContent, str]:
    """Read a journal that no process is writing, and make a damaged one whole.

    The damaged files stay beside the new ones, under another name.
    """
    _finish_replacement(path)
    content = read_journal(path)
    used = (
        f"everything before it is used ({counted(len(content.trials), 'trial')}, "
        f"{counted(len(content.evaluations), 'test run')})"
    )
    if not content.damage:
        lost = _lost_commits(path)
        return content, f"{lost}; {used}" if lost else ""
    kept = _keep_damaged(path)
    sessions = content.sessions or ({},)
    session = dict(sessions[-1]) | {"salvaged_from": kept.name}
    create_journal(
        _whole(path), (*sessions, session), content.evaluations, content.trials, content.events
    )
    _finish_replacement(path)
    return content, f"{content.damage}; {used}, the damaged file is kept as {kept.name}"


def withdraw_lost(path: Path, content: JournalContent) -> JournalContent:
    """Take back the trials that were lost last, so that they are run again; returns the rest.

    No later trial was proposed with knowledge of them. Their evaluations stay on record, and those
    that are complete are not run again. A lost trial that others follow stays: these were proposed
    when it had been lost twice.
    """
    kept = len(content.trials)
    while kept and (last := content.trials[kept - 1]).unusable and not last.was_withdrawn:
        kept -= 1
    if kept == len(content.trials):
        return content
    rest = replace(content, trials=content.trials[:kept])
    create_journal(_whole(path), rest.sessions, rest.evaluations, rest.trials, rest.events)
    _finish_replacement(path)
    return rest


def _lost_commits(path: Path) -> str:
    """Return in words that SQLite passes over commits of the write-ahead log; empty if it does not.

    What a kill leaves of a commit is no damage. The format of the log is described at
    https://www.sqlite.org/walformat.html.
    """
    log = path.with_name(f"{path.name}-wal")
    try:
        data = log.read_bytes() if log.exists() else b""
        if len(data) < _WAL_HEADER.size:
            return ""
        _, _, page, _, salt, pepper, _, _ = _WAL_HEADER.unpack_from(data)
        with closing(sqlite3.connect(path)) as db:
            _, valid, _ = db.execute("PRAGMA wal_checkpoint(PASSIVE)").fetchone()
    except (OSError, sqlite3.Error) as error:
        return f"{log.name}: {error}"
    size = _FRAME_HEADER.size + page
    for start in range(_WAL_HEADER.size + valid * size, len(data) - size + 1, size):
        _, is_commit, *salts, _, _ = _FRAME_HEADER.unpack_from(data, start)
        # Frames with other salts are from before SQLite began the log anew.
        if salts != [salt, pepper]:
            break
        if is_commit:
            return f"{log.name}: damaged after page {valid}"
    return ""


def _whole(path: Path) -> Path:
    """Return where the journal stands that is about to take the place of a damaged one."""
    return path.with_name(f"{path.stem}.whole{path.suffix}")


def _keep_damaged(path: Path) -> Path:
    """Copy a journal and its log, and return the copy's path."""
    number = 1
    while (kept := path.with_name(f"{path.stem}.damaged-{number}{path.suffix}")).exists():
        number += 1
    try:
        # The journal last: a copy that a kill has cut short is made again.
        for suffix in ("-wal", ""):
            file = path.with_name(path.name + suffix)
            if file.exists():
                write_atomically(kept.with_name(kept.name + suffix), file.read_bytes())
    except OSError as error:
        raise JournalError(f"{path}: cannot be copied: {error.strerror or error}") from error
    return kept


def _finish_replacement(path: Path) -> None:
    """Put a journal that was made whole into its place, also one that a killed process left there.

    The log goes first: SQLite would add the commits of the damaged journal to the new one.
    """
    whole = _whole(path)
    if not whole.exists():
        return
    try:
        for suffix in ("-wal", "-shm"):
            path.with_name(path.name + suffix).unlink(missing_ok=True)
        synchronize(path.parent)
        whole.replace(path)
        synchronize(path.parent)
    except OSError as error:
        raise JournalError(f"{path}: cannot be replaced: {error.strerror}") from error
