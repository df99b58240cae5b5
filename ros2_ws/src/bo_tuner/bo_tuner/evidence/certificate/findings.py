"""The evidence for a certificate: the evaluations, and what they show for each constraint."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Annotated

from bo_tuner.codec.rules import Chosen
from bo_tuner.evidence.certificate.risk import Mean
from bo_tuner.evidence.estimates import Estimate
from bo_tuner.evidence.reasons import Assumption, Reason
from bo_tuner.study.limit_kinds.limited import UPPER
from bo_tuner.study.noiseless import Noisy
from bo_tuner.study.ranges import OutOfRange
from bo_tuner.trials import Context, Evaluation, Stage, Value

TAIL = 0.95
"""Level of the conditional value at risk, here the mean of the worst 5 % of the draws."""


def widest(side: str, bounds: Iterable[float]) -> float:
    """Return the bound, of those in several contexts, that decides whether a limit is kept."""
    return max(bounds) if side == UPPER else min(bounds)


@dataclass(frozen=True)
class RefutingRuns:
    """Runs of the tuning run that refute a limit: their number, and that of their contexts."""

    constraint: str
    runs: int
    contexts: int


@dataclass(frozen=True)
class Refutation:
    """What a parameter set failed on before.

    Attributes
    ----------
    contexts
        The contexts in which it failed; empty if only the draws as a whole show it.
    certificate, findings
        Number of the certificate that was a FAIL, such as ``0001``, and its findings.
    runs
        Without a certificate: those of the tuning run itself.
    """

    contexts: tuple[Context, ...]
    certificate: str = ""
    findings: "Findings | None" = None
    runs: RefutingRuns | None = None


@dataclass(frozen=True)
class Earlier:
    """The evidence on a parameter set from before its certificate.

    Its runs count against a PASS, never for it: they were made, or chosen, knowing what came out.

    Attributes
    ----------
    refutations
        What it failed on, in the order of the certificates.
    evaluations
        All runs: those of earlier certificates, and of the tuning run.
    certified
        Whether there was a certificate before.
    unread
        Why earlier evidence could not be read, a line for each file.
    """

    refutations: tuple[Refutation, ...] = ()
    evaluations: tuple[Evaluation, ...] = ()
    certified: bool = False
    unread: tuple[str, ...] = ()

    @cached_property
    def contexts(self) -> list[Context]:
        """The contexts in which it failed, each once."""
        contexts: list[Context] = []
        for refutation in self.refutations:
            contexts += [context for context in refutation.contexts if context not in contexts]
        return contexts

    @cached_property
    def drawn(self) -> tuple[Evaluation, ...]:
        """The runs in draws of context and noise."""
        return tuple(e for e in self.evaluations if e.stage is Stage.VALIDATION)

    @cached_property
    def extremes(self) -> Mapping[str, tuple[float, float]]:
        """The smallest and the largest value of each metric in all runs."""
        by_metric: dict[str, list[float]] = {}
        for evaluation in self.evaluations:
            for name, value in evaluation.outcome.metrics.items():
                by_metric.setdefault(name, []).append(value)
        return {name: (min(values), max(values)) for name, values in by_metric.items()}

    def at(self, context: Context) -> list[Evaluation]:
        """Return the runs in exactly this context."""
        return self._by_context.get(frozenset(context.items()), [])

    @property
    def in_brief(self) -> "EarlierInBrief":
        """What a certificate says of it."""
        return EarlierInBrief(self.refutations, len(self.evaluations), self.unread)

    @cached_property
    def _by_context(self) -> Mapping[frozenset[tuple[str, Value]], list[Evaluation]]:
        by_context: dict[frozenset[tuple[str, Value]], list[Evaluation]] = {}
        for evaluation in self.evaluations:
            by_context.setdefault(frozenset(evaluation.context.items()), []).append(evaluation)
        return by_context


@dataclass(frozen=True)
class EarlierInBrief:
    """What a certificate says of the evidence from before.

    Attributes
    ----------
    refutations
        What the parameter set failed on.
    evaluations
        Number of all runs.
    unread
        Why earlier evidence could not be read, a line for each file.
    """

    refutations: tuple[Refutation, ...]
    evaluations: int
    unread: tuple[str, ...]


NOTHING = Earlier()
"""What is known of a parameter set that nobody has looked at."""


@dataclass(frozen=True)
class Evidence:
    """The evaluations of one parameter set.

    Attributes
    ----------
    parameters
        The parameter set.
    drawn
        Evaluations in independent draws of context and noise.
    search
        Evaluations of the search for the worst context.
    repeated
        For each context that the search found, evaluations there with fresh noise.
    unvisited
        By constraint, how many contexts of its search were not run, because another context had
        decided the verdict.
    unseen
        Names of the constraints that have no run in any context of their search for that reason.
    earlier
        What was known of it before; counts against it only.
    repeats
        Of a study that declares its runs free of noise: draws once more, with other seeds.
    """

    parameters: Mapping[str, Value]
    drawn: tuple[Evaluation, ...]
    search: tuple[Evaluation, ...] = ()
    repeated: tuple[tuple[Evaluation, ...], ...] = ()
    unvisited: Mapping[str, int] = field(default_factory=dict)
    unseen: frozenset[str] = frozenset()
    earlier: Earlier = NOTHING
    repeats: tuple[Evaluation, ...] = ()

    @property
    def evaluations(self) -> tuple[Evaluation, ...]:
        """All its own evaluations, in the order drawn, search, repeated, repeats."""
        return (*self.drawn, *self.others, *self.repeats)

    @property
    def others(self) -> tuple[Evaluation, ...]:
        """Those of the search for the worst context, and in what it has found."""
        in_contexts = (evaluation for group in self.repeated for evaluation in group)
        return (*self.search, *in_contexts)


@dataclass(frozen=True)
class WorstContext:
    """The constrained metric in a context that may be the worst, over fresh noise.

    Attributes
    ----------
    context
        The context.
    mean
        Mean of the metric over noise.
    extreme
        Single value farthest on the side of the limit.
    evaluations, beyond, failures
        Number of complete evaluations, of those beyond the limit, and of failed ones.
    violation_bound
        Upper confidence bound of the probability that a run in this context violates the limit.
    shown
        Whether the limit is shown to hold in this context.
    needs_range
        Whether only a range of the metric would bound the mean, as the runs are of two kinds.
    contradicted
        Whether the evaluations alone would show it, and earlier ones keep them from it.
    earlier
        Number of earlier runs in this context, which count against it.
    together
        What these and the evaluations show together: the mean of the metric or, for a limit on
        single runs, the share of those beyond it or failed. NaN without earlier ones.
    """

    context: Context
    mean: Mean
    extreme: float
    evaluations: int
    beyond: int
    failures: int
    violation_bound: float
    shown: bool
    needs_range: bool = False
    contradicted: bool = False
    earlier: int = 0
    together: float = float("nan")


@dataclass(frozen=True)
class ConstraintVerdict:
    """The verdict on one constraint.

    Attributes
    ----------
    name, kind, metric, unit, limit
        Of the constraint in the study; the limit in `unit`.
    side
        Which limit it is: ``upper`` or ``lower``.
    allowed
        Largest permitted probability of a violation, as `Constraint.allowed`.
    draws, violations, failures
        Number of draws, of complete ones beyond the limit, and of failed ones.
    violation_bound
        Upper confidence bound of the probability that a draw violates the limit or fails.
    extreme
        Value of the draws farthest on the side of the limit.
    tail
        Conditional value at risk of the draws at level `TAIL`, of the smallest for a lower limit.
    worst
        For a worst case: the contexts that may be the worst, by their mean, the worst one first.
    assumption
        On what it rests besides the numbers of runs that are counted; None if on nothing.
    refuted
        Whether runs show that it does not hold.
    passed, reason
        Whether the constraint is shown to hold, and why or why not.
    """

    name: str
    kind: str
    metric: str
    unit: str
    limit: float
    side: str
    allowed: float
    draws: int
    violations: int
    failures: int
    violation_bound: float
    extreme: float
    tail: float
    worst: tuple[WorstContext, ...]
    assumption: Assumption | None
    refuted: bool
    passed: bool
    reason: Reason


@dataclass(frozen=True)
class Failure:
    """A failed run: why, in which context, and the seed of its noise."""

    why: str
    context: Context
    seed: int


def _contradiction(value: object) -> type[OutOfRange | Noisy]:
    return Noisy if isinstance(value, Mapping) and "seeds" in value else OutOfRange


@dataclass(frozen=True)
class Findings:
    """Statistics and verdicts from the evaluations of one parameter set.

    Attributes
    ----------
    parameters
        The parameter set.
    objective
        The mean of the objective's metric by the draws.
    tail
        Its conditional value at risk: the mean over the draws that are worst for the objective.
    evaluations, failures
        Number of all evaluations, and of those that did not complete.
    first_failure
        The first failure; None without one.
    contradiction
        How runs contradict the declared range of a metric, or that they are free of noise: a fault
        of the declaration; None if they do not.
    least
        Fewest runs with which any certificate shows these limits with its confidence.
    constraints
        One for each constraint of the study.
    """

    parameters: Mapping[str, Value]
    objective: Estimate
    tail: float
    evaluations: int
    failures: int
    first_failure: Failure | None
    contradiction: Annotated[OutOfRange | Noisy | None, Chosen(_contradiction)]
    least: int
    constraints: tuple[ConstraintVerdict, ...]

    @property
    def passed(self) -> bool:
        """Whether every constraint is shown to hold, and no run failed or contradicts the study."""
        return (
            self.failures == 0
            and self.contradiction is None
            and all(c.passed for c in self.constraints)
        )
