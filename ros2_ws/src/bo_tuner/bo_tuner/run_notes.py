"""What is noted of a run beside its metrics, and beside what nodes report themselves."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum

EVEN = 2.0
"""Largest distance of the messages of an even signal, in nine of ten cases, in usual distances."""


class Unusable(StrEnum):
    """Why a failed evaluation says nothing of its parameters.

    Somebody else acted on the nodes, or it did not begin: the steps before it failed with the safe
    parameters, or the default failed, which a limit is relative to. Or somebody has withdrawn it.
    """

    DISTURBED = "disturbed"
    UNPREPARED = "unprepared"
    WITHDRAWN = "withdrawn"


@dataclass(frozen=True)
class Death:
    """A node that died in a run.

    Attributes
    ----------
    node
        Its key in the study.
    anyway
        Whether it does so whatever the parameters are (`NodeSpec.death`).
    """

    node: str
    anyway: bool = False


@dataclass(frozen=True)
class Messages:
    """How many messages of a signal came in a run; lost ones did not, late ones were dropped."""

    messages: int
    lost: int
    late: int


@dataclass(frozen=True)
class Rate:
    """How often the messages of a signal came in a run.

    Attributes
    ----------
    messages
        Number of them.
    distance
        Median of the time between two messages [s].
    most
        What that time does not exceed in nine of ten cases [s].
    gap
        Longest time without a message [s], start and end included.
    duration
        Of the run [s].
    """

    messages: float
    distance: float
    most: float
    gap: float
    duration: float

    @property
    def even(self) -> bool:
        """Whether messages come in even distances, so that their number can be too small."""
        return self.most <= EVEN * self.distance


@dataclass(frozen=True)
class Published:
    """How the messages of a reference were published in a run.

    Attributes
    ----------
    messages, left_out
        Their number; those that were left out were late by a period or more.
    late, latest
        Mean, and largest, of the times [s] by which they were late.
    gap
        Longest time [s] between two of them.
    """

    messages: int
    left_out: int
    late: float
    latest: float
    gap: float


@dataclass(frozen=True)
class Notes:
    """What is noted of a run.

    Attributes
    ----------
    unusable
        Why it says nothing of its parameters; None if it does, or was lost.
    death
        Of a node, with the values of the run in force.
    deaths
        How often nodes died anyway until the run came to an end.
    gap
        For how long [s] a signal had no message, where it failed for that; None elsewhere.
    cut_after
        Time of the run [s] at which it was cut short; None if it was not.
    at_least
        Metrics that only grow during a run, as they were when it was cut short.
    default
        The default's metrics that others are relative to, in the same context with the same seed.
    carried_from
        The run that it was taken over from.
    as_set
        Parameters that had another value than they were to have, by name, with that value.
    errors
        Known standard errors of metrics, by name, each in its unit.
    remark
        What to know of its metrics, such as signals that were silent, in a line.
    park_problem
        What went wrong when the nodes were left safe after a complete run.
    starts, start_seconds
        How often nodes were started anew with other values ahead of it or because of it, and the
        time [s] that this took.
    warm_ups, warm_up_seconds
        Runs that warmed the machine up ahead of it, and their time [s], which is not part of its
        own.
    rested_seconds, ramped_seconds
        How long [s] the machine was waited for to rest ahead of it, and parameters were under way
        for it, to its own and back to safe ones.
    ignored_results
        Results that were not of this run.
    signals, rates, streams
        By name the messages of the signals, how often they came, None of too few, and what was
        published.
    played
        Numbers of messages of a bag that were played, by their topics.
    held
        By node and parameter, as ``node.parameter``, the value that a device has in place of the
        one it was set to, since it keeps fewer digits; of an array a list as JSON.
    """

    unusable: Unusable | None = None
    death: Death | None = None
    deaths: int = 0
    gap: float | None = None
    cut_after: float | None = None
    at_least: Mapping[str, float] = field(default_factory=dict)
    default: Mapping[str, float] = field(default_factory=dict)
    carried_from: str = ""
    as_set: Mapping[str, bool | int | float | str] = field(default_factory=dict)
    errors: Mapping[str, float] = field(default_factory=dict)
    remark: str = ""
    park_problem: str = ""
    starts: int = 0
    start_seconds: float = 0.0
    warm_ups: int = 0
    warm_up_seconds: float = 0.0
    rested_seconds: float = 0.0
    ramped_seconds: float = 0.0
    ignored_results: int = 0
    signals: Mapping[str, Messages] = field(default_factory=dict)
    rates: Mapping[str, Rate | None] = field(default_factory=dict)
    streams: Mapping[str, Published] = field(default_factory=dict)
    played: Mapping[str, int] = field(default_factory=dict)
    held: Mapping[str, bool | int | float | str] = field(default_factory=dict)
