"""Notes and tags of a reader on a run and on its trials, in a file beside the journal.

The journal is the record of what was done and never holds what somebody thinks of it, so the notes
may be changed at any time, while the run goes on and after it.
"""

import json
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Self

from bo_tuner.errors import RunRecordError
from bo_tuner.storage.run_files import read_text
from bo_tuner.storage.run_folder import write_json
from bo_tuner.storage.typed_json import from_json, to_json

NOTES = "notes.json"
LONGEST_NOTE = 2000
"""Characters of a note."""
LONGEST_TAG, MOST_TAGS = 30, 10
"""Characters of a tag, and tags on a run or a trial."""


@dataclass(frozen=True)
class Note:
    """What a reader has noted of a run or a trial.

    Attributes
    ----------
    text
        In any words; it may have several lines.
    tags
        Words to filter by.
    """

    text: str = ""
    tags: tuple[str, ...] = ()

    @classmethod
    def of(cls, text: str, tags: str) -> Self:
        """Return a note with tags that are separated by commas.

        Raises
        ------
        ValueError
            If something is too long: with one line on it.
        """
        # A browser may cut a character in two, half of which no file takes.
        text, tags = (given.encode(errors="replace").decode() for given in (text, tags))
        text = text.replace("\r\n", "\n").strip()
        words = tuple(dict.fromkeys(filter(None, (" ".join(t.split()) for t in tags.split(",")))))
        if len(text) > LONGEST_NOTE:
            raise ValueError(f"note: expected at most {LONGEST_NOTE} characters, found {len(text)}")
        if len(words) > MOST_TAGS:
            raise ValueError(f"tags: expected at most {MOST_TAGS}, found {len(words)}")
        if too_long := [word for word in words if len(word) > LONGEST_TAG]:
            raise ValueError(
                f"tags: expected at most {LONGEST_TAG} characters each, found {too_long[0][:60]}"
            )
        return cls(text, words)


@dataclass(frozen=True)
class Notes:
    """The notes on a run, and on its trials by their number."""

    run: Note = Note()
    trials: Mapping[str, Note] = field(default_factory=dict)

    def of(self, trial: int | None) -> Note:
        """Return the note on a trial; that on the run for None."""
        return self.run if trial is None else self.trials.get(str(trial), Note())


def read_notes(folder: Path) -> Notes:
    """Read the notes on the run in a folder; there may be none.

    Raises
    ------
    RunRecordError
        If the file cannot be read.
    """
    path = folder / NOTES
    try:
        return from_json(Notes, json.loads(read_text(path)))
    except FileNotFoundError:
        return Notes()
    except OSError as error:
        raise RunRecordError(f"{path}: cannot be read: {error.strerror or error}") from error
    except (ValueError, RecursionError) as error:
        raise RunRecordError(f"{path}: not the notes on a run: {str(error)[:200]}") from error


def write_note(folder: Path, trial: int | None, note: Note) -> None:
    """Put a note on a trial, or on the run for None, in place of what was noted before.

    Raises
    ------
    RunRecordError
        If the notes so far cannot be read.
    OutputError
        If they cannot be written.
    """
    notes = read_notes(folder)
    if trial is None:
        notes = replace(notes, run=note)
    else:
        trials = {**notes.trials, str(trial): note}
        kept = {name: each for name, each in trials.items() if each != Note()}
        notes = replace(notes, trials=kept)
    write_json(folder / NOTES, to_json(notes))
