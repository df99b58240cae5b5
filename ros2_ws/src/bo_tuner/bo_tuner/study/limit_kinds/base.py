"""The interface of a kind of limit."""

from abc import ABC, abstractmethod
from typing import ClassVar, Protocol, TypeVar

from bo_tuner.numerics.arrays import Array
from bo_tuner.study.limit_kinds.limited import Limited

R = TypeVar("R")
R_co = TypeVar("R_co", covariant=True)


class Responses(Protocol[R_co]):
    """Makes of a limit what models can predict and compare with it."""

    def over_contexts(self, limited: Limited, level: float) -> R_co:
        """Return the limit on the quantile `level` of runs over contexts and noise."""

    def in_every_context(self, limited: Limited, deviations: float) -> R_co:
        """Return the limit on the mean over noise in every context, plus so many deviations."""


class LimitKind(ABC):
    """One limit, with the rules of its kind.

    Attributes
    ----------
    in_every_context
        Whether it must be kept in every context, so that the worst one is searched, or over their
        distribution, which draws can show.
    on_runs
        Whether a share of single runs must keep it, or the mean over noise.
    """

    in_every_context: ClassVar[bool]
    on_runs: ClassVar[bool]

    def __init__(self, limited: Limited) -> None:
        self.limited = limited

    @abstractmethod
    def check(self) -> None:
        """Refuse a limit that does not have the fields of this kind.

        Raises
        ------
        StudyError
            With the key that is wrong.
        """

    @property
    @abstractmethod
    def level(self) -> float:
        """Probability with which a run must keep the limit; one half for one on the mean.

        With symmetric noise a run keeps a limit at its mean with this probability.
        """

    @property
    @abstractmethod
    def allowed(self) -> float:
        """Largest permitted probability that a run violates the limit; 1 for one on the mean."""

    @abstractmethod
    def response(self, models: Responses[R]) -> R:
        """Return the limit in the form in which `models` predict it."""

    def is_estimated(self, *, alone: bool) -> bool:
        """Return whether draws estimate the limited quantity, and do not only refute the limit.

        With `alone` all draws are in one context, the only one that there is.
        """
        return alone or not self.in_every_context

    @abstractmethod
    def permitted(self, count: int) -> int | None:
        """Return how many of `count` runs may be beyond the limit; None if it is on the mean."""

    @abstractmethod
    def agrees(self, values: Array, *, alone: bool) -> bool:
        """Return whether the values (n,) of draws, one at least, agree with the limit."""

    @abstractmethod
    def is_shown_by(self, violations: int, count: int, confidence: float) -> bool:
        """Return whether `violations` in `count` independent runs show that the limit is kept."""
