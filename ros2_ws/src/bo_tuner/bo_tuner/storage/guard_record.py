"""What the guards of a run have done: a line of JSON for each act, beside the logs."""

import json
import os
from dataclasses import dataclass
from pathlib import Path

from bo_tuner.codec.reading import JSON, read
from bo_tuner.codec.writing import to_json
from bo_tuner.storage.run_files import GUARD_RECORD, read_text
from bo_tuner.text import brief


@dataclass(frozen=True)
class Act:
    """An act of a guard.

    Attributes
    ----------
    time : str
        When it began, ISO 8601 in UTC.
    reason : str
        Why.
    stop_seconds, safe_seconds : float
        Time [s] until the stop messages were sent, and until the safe values were read back.
    problems : tuple of str
        What was not safe then.
    """

    time: str
    reason: str
    stop_seconds: float
    safe_seconds: float
    problems: tuple[str, ...] = ()

    def __str__(self) -> str:
        outcome = "; ".join(self.problems) or "it was left safe"
        return brief(f"{self.time}: the guard has stopped the machine: {self.reason}; {outcome}")


def add_act(path: Path, act: Act) -> None:
    """Add an act to a record, and have it on the disk; raises `OSError`."""
    with path.open("a", encoding="utf-8") as file:
        file.write(json.dumps(to_json(act)) + "\n")
        file.flush()
        os.fsync(file.fileno())


def read_acts(log: Path) -> list[Act]:
    """Return the acts on record in a log folder, those of workers included, in the order of time.

    What cannot be read is passed over.
    """
    records = [log / GUARD_RECORD, *log.glob(f"worker-*/{GUARD_RECORD}")]
    return sorted((act for path in records for act in _acts(path)), key=lambda act: act.time)


def _acts(record: Path) -> list[Act]:
    try:
        lines = read_text(record).splitlines()
    except (OSError, ValueError):
        return []
    acts = []
    for line in lines:
        try:
            acts.append(read(Act, json.loads(line), JSON))
        except (ValueError, RecursionError):
            continue
    return acts
