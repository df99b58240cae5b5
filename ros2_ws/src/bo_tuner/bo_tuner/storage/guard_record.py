"""What the guards of a run have done: a line of JSON for each act, beside the logs."""

import json
import os
from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path

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
    problems : list of str
        What was not safe then.
    """

    time: str
    reason: str
    stop_seconds: float
    safe_seconds: float
    problems: Sequence[str] = ()

    def __str__(self) -> str:
        outcome = "; ".join(map(str, self.problems)) or "it was left safe"
        return brief(f"{self.time}: the guard has stopped the machine: {self.reason}; {outcome}")


def add_act(path: Path, act: Act) -> None:
    """Add an act to a record, and have it on the disk; raises `OSError`."""
    with path.open("a", encoding="utf-8") as file:
        file.write(json.dumps(asdict(act)) + "\n")
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
            content = json.loads(line)
            values = {item.name: content[item.name] for item in fields(Act)}
            problems = [str(problem) for problem in values["problems"]]
            # Times are put in order: a text and a number have none.
            if isinstance(values["time"], str):
                acts.append(Act(**values | {"problems": problems}))
        except (ValueError, TypeError, KeyError, RecursionError):
            continue
    return acts
