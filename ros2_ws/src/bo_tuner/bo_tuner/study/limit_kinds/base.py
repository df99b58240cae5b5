"""The interface of a kind of limit."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
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


@dataclass(frozen=True, eq=False)
class Runs:
    """Runs of one parameter set, in draws of the context or in a single one.

    Attributes
    ----------
    events
        Whether each violates the limit or failed.
    values : ndarray, shape (n,)
        The metric in the complete ones.
    farthest
        Value farthest on the side of the limit in all runs of the parameter set that are known;
        NaN of none.
    declared
        Smallest and largest value that any run can have; None if that is not known.
    exact
        Whether one run decides: they are of a simulator without noise, and of one context, or each
        of a context in which the limit must be kept.
    """

    events: Sequence[bool]
    values: Array
    farthest: float = float("nan")
    declared: tuple[float, float] | None = None
    exact: bool = False


class BoundedMean(Protocol):
    """A mean over noise with its confidence bounds."""

    @property
    def value(self) -> float:
        """The mean."""

    def bound(self, side: str) -> float:
        """Return the bound on a side, ``upper`` or ``lower``."""


class InContext(Protocol):
    """What runs in one context have shown."""

    @property
    def mean(self) -> BoundedMean:
        """Mean over noise."""

    @property
    def evaluations(self) -> int:
        """Number of complete runs."""

    @property
    def beyond(self) -> int:
        """Number of those beyond the limit."""

    @property
    def needs_range(self) -> bool:
        """Whether only a range of the metric would bound the mean, as runs are of two kinds."""

    @property
    def violation_bound(self) -> float:
        """Upper confidence bound of the probability of a violation."""

    @property
    def place(self) -> str:
        """The values of the context, in words; empty if there are none."""


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

    @abstractmethod
    def fewest(self, declared: tuple[float, float] | None, confidence: float) -> int:
        """Return the least number of runs in a context that show it, by the range of the metric."""

    def assumption(self, declared: tuple[float, float] | None) -> tuple[str, str]:
        """Return the assumption under which runs show the limit, and briefly; empty if none."""
        return "", ""

    @abstractmethod
    def is_shown(self, runs: Runs, confidence: float) -> bool:
        """Return whether runs of a certificate show the limit; valid however often it is asked."""

    @abstractmethod
    def is_refuted(self, runs: Runs, confidence: float) -> bool:
        """Return whether the runs refute the limit."""

    @abstractmethod
    def is_hopeless(self, runs: Runs, most: int, confidence: float) -> bool:
        """Return whether the runs, continued to `most` of them, cannot show the limit any more."""

    def needs_range(self, runs: Runs) -> bool:
        """Return whether the runs can show the limit only if their metric declares a range."""
        return False

    @abstractmethod
    def together(self, runs: Runs) -> float:
        """Return the limited quantity of all runs taken together; NaN of none."""

    @abstractmethod
    def contradicts(self, together: float) -> bool:
        """Return whether the quantity that `together` returned is beyond the limit."""

    @abstractmethod
    def asked(self, *, everywhere: bool) -> str:
        """Return how often the limit must be kept, in a few words."""

    @abstractmethod
    def counted(self, violations: int, runs: str, count: int, *, agrees: bool) -> str:
        """Return what was counted in complete test runs: `count` of them, in words `runs`."""

    @abstractmethod
    def said_of_draws(self, runs: Runs, unit: str, confidence: float, *, passed: bool) -> str:
        """Return why the draws of a certificate show the limit, or do not."""

    @abstractmethod
    def said_of_contexts(
        self,
        worst: Sequence[InContext],
        refuting: Sequence[InContext],
        unit: str,
        *,
        passed: bool,
    ) -> str:
        """Return why the runs in the worst contexts show the limit, or do not.

        Parameters
        ----------
        worst
            The contexts that may be the worst, by their mean, the worst one first.
        refuting
            Those that refute the limit.
        unit
            Of the metric.
        passed
            Whether it is shown.
        """

    @abstractmethod
    def said_together(self, both: str, together: float) -> str:
        """Return that earlier and fresh runs, in words `both`, together break the limit."""

    @abstractmethod
    def predicted(self, metric: str, *, quantile: bool) -> str:
        """Name what models predict in a figure: a quantile of runs, or a mean, of a `metric`."""

    @property
    @abstractmethod
    def decisive(self) -> str:
        """What is compared with the limit in a figure of the worst contexts, in words."""


def place_of(top: InContext, worst: Sequence[InContext]) -> str:
    """Name a context among the worst ones, with a space at its end; empty if there is but one."""
    which = "the worst context" if top is worst[0] else "the least certain of the worst contexts"
    return f"in {which} ({top.place}) " if top.place else ""
