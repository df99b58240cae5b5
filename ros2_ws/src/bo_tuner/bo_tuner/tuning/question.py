"""A question to whoever watches a run: whether the next parameter set may be tried.

It may be answered in several places, from any thread; the first answer counts.
"""

import threading
from dataclasses import dataclass
from enum import StrEnum

from bo_tuner.trials import Value


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


@dataclass(frozen=True)
class Change:
    """A tuned parameter of the next set: what it is now, would be, and is by default."""

    title: str
    now: Value
    then: Value
    default: Value


@dataclass(frozen=True)
class Expected:
    """A prediction with its band, and the limit on it.

    Attributes
    ----------
    what, unit
        Of what, and its unit.
    value, low, high
        Mean and ends of the band.
    limit
        None without one.
    is_upper
        Whether the limit is an upper one.
    words
        Which value the limit is on, such as a quantile.
    """

    what: str
    unit: str
    value: float
    low: float
    high: float
    limit: float | None = None
    is_upper: bool = True
    words: str = ""


@dataclass(frozen=True)
class Asked:
    """What there is to know of a parameter set before it is tried.

    Attributes
    ----------
    trial
        Its number.
    origin
        Why it is proposed, as in `Trial`.
    before
        What the parameters are now, in words.
    changes, expected
        The tuned parameters, and what models predict.
    remarks
        The nearest sets that were tried, or why nothing is predicted.
    """

    trial: int
    origin: str
    before: str
    changes: tuple[Change, ...]
    expected: tuple[Expected, ...] = ()
    remarks: tuple[str, ...] = ()


class Question:
    """The question at hand, if there is one.

    Attributes
    ----------
    number
        How many were asked until now, this one included.
    asked
        What it is about; None while nothing is asked.
    given
        Its answer; None until somebody gives one.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self.number = 0
        self.asked: Asked | None = None
        self.given: Given | None = None

    def pose(self, asked: Asked) -> None:
        """Ask, with what there is to know."""
        with self._lock:
            self.number += 1
            self.asked, self.given = asked, None

    def answer(self, given: Given, number: int | None = None) -> bool:
        """Take an answer; returns whether it counts."""
        with self._lock:
            is_open = self.asked is not None and self.given is None
            counts = is_open and number in (None, self.number)
            if counts:
                self.given = given
            return counts

    def close(self) -> None:
        """Ask nothing any more."""
        with self._lock:
            self.asked = None
