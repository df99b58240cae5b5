"""Sentences on a limit, for each kind of limit; `words_of` has those of a limit."""

from abc import ABC, abstractmethod
from functools import singledispatch

from bo_tuner.study.constraint import Constraint
from bo_tuner.study.limit_kinds.base import LimitKind
from bo_tuner.study.limit_kinds.on_mean import OnMean
from bo_tuner.study.limit_kinds.on_runs import OnRuns


class Words(ABC):
    """What is said of a limit, whose kind is the `rule`."""

    def __init__(self, rule: LimitKind) -> None:
        self.rule, self.limited = rule, rule.limited

    @abstractmethod
    def asked(self, *, everywhere: bool) -> str:
        """Return how often the limit must be kept, in a few words."""

    @abstractmethod
    def counted(self, violations: int, runs: str, count: int, *, agrees: bool) -> str:
        """Return what was counted in complete test runs: `count` of them, in words `runs`."""

    @abstractmethod
    def predicted(self, metric: str, *, quantile: bool) -> str:
        """Name what models predict in a figure: a quantile of runs, or a mean, of a `metric`."""

    @property
    @abstractmethod
    def decisive(self) -> str:
        """What is compared with the limit in a figure of the worst contexts, in words."""


class OfRuns(Words):
    """Of a limit that a share of single runs must keep."""

    def asked(self, *, everywhere: bool) -> str:  # noqa: D102
        share = f"in {100.0 * self.rule.level:g} % of the runs"
        return f"{share} in every context" if everywhere else share

    def counted(self, violations: int, runs: str, count: int, *, agrees: bool) -> str:  # noqa: D102
        permitted = self.rule.permitted(count)
        return f"{violations} of {runs} {self.limited.beyond} the limit, {permitted} permitted"

    def predicted(self, metric: str, *, quantile: bool) -> str:  # noqa: D102
        worst = self.rule.in_every_context
        if quantile:
            level = self.rule.level if self.limited.sign > 0.0 else self.rule.allowed
            return f"{'worst ' if worst else ''}{level:.4g} quantile of {metric}"
        return f"{'worst' if worst else 'mean'} {metric}"

    @property
    def decisive(self) -> str:  # noqa: D102
        return (
            "What a run in the worst context that was found keeps with a probability of "
            f"{self.rule.level:g}"
        )


class OfMean(Words):
    """Of a limit that the mean over noise keeps."""

    def asked(self, *, everywhere: bool) -> str:  # noqa: D102
        return f"by the mean over noise{' in every context' if everywhere else ''}"

    def counted(self, violations: int, runs: str, count: int, *, agrees: bool) -> str:  # noqa: D102
        beyond = self.limited.beyond
        if not agrees:
            return f"the mean over {runs} is {beyond} the limit"
        text = f"{violations} of {runs} {beyond} the limit"
        return f"{text}, which is on the mean" if violations else text

    def predicted(self, metric: str, *, quantile: bool) -> str:  # noqa: D102
        return f"{'worst' if self.rule.in_every_context else 'mean'} {metric}"

    @property
    def decisive(self) -> str:  # noqa: D102
        return "The mean in the worst context that was found"


@singledispatch
def words_of_kind(rule: LimitKind) -> Words:
    """Return what is said of a limit, by the class of its kind."""
    raise TypeError(f"no words for a limit of the kind {type(rule).__name__}")


words_of_kind.register(OnRuns, OfRuns)
words_of_kind.register(OnMean, OfMean)


def words_of(constraint: Constraint) -> Words:
    """Return what is said of a limit."""
    return words_of_kind(constraint.rule)
