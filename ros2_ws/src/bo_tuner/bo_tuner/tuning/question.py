"""A question to whoever watches a run: whether the next parameter set may be tried.

It may be answered in several places, from any thread; the first answer counts.
"""

import threading
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum


class Reply(StrEnum):
    """What may be answered: try it; not this one, but another one; no more trials."""

    ACCEPT = "accept"
    REFUSE = "refuse"
    END = "end"


@dataclass(frozen=True)
class Given:
    """An answer.

    Attributes
    ----------
    reply
        What was answered.
    on
        Where, such as ``terminal``.
    by
        Who, as far as that is known there; else empty.
    """

    reply: Reply
    on: str
    by: str = ""


class Question:
    """The question at hand, if there is one.

    Attributes
    ----------
    number
        How many were asked until now, this one included.
    lines
        What it is about; empty while nothing is asked.
    given
        Its answer; None until somebody gives one.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self.number = 0
        self.lines: tuple[str, ...] = ()
        self.given: Given | None = None

    def pose(self, lines: Sequence[str]) -> None:
        """Ask, with what there is to know, in lines."""
        with self._lock:
            self.number += 1
            self.lines, self.given = tuple(lines), None

    def answer(self, given: Given, number: int | None = None) -> bool:
        """Take an answer; returns whether it counts.

        Parameters
        ----------
        given
            The answer.
        number
            Of the question that was read; None for the one at hand.
        """
        with self._lock:
            is_open = bool(self.lines) and self.given is None
            counts = is_open and number in (None, self.number)
            if counts:
                self.given = given
            return counts

    def close(self) -> None:
        """Ask nothing any more."""
        with self._lock:
            self.lines = ()
