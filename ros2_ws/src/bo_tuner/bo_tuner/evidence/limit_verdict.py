"""What was found of one limit, in numbers.

Few test runs cannot show that a limit is kept: they are counted, beside how many violations the
limit permits. *Kept* is only what is shown. The words are those of `words.limits`.
"""

from dataclasses import dataclass
from math import nan

from bo_tuner.evidence.reasons import Assumption
from bo_tuner.study.constraint import Constraint
from bo_tuner.study.limits import Sample, Standing
from bo_tuner.study.study import Study


@dataclass(frozen=True, kw_only=True)
class LimitVerdict:
    """What was found of a limit.

    Attributes
    ----------
    constraint, title, unit
        The limit, what screens call it, and the unit of its metric.
    standing
        Whether it is proven to be kept, open, or violated.
    runs, violations
        Number of test runs, and of those beyond the limit.
    everywhere
        Whether it must be kept in every one of several contexts.
    certified
        Whether a certificate says so, which has more to say; else test runs alone.
    unsearched
        Whether runs count against it which do not refute it, as nobody searched for its worst
        context.
    refuted
        Whether the runs show that the limit is not kept; else a violated one is not proven.
    condition
        What it rests on that runs do not prove; None if on nothing.
    confidence
        With which test runs show it.
    """

    constraint: Constraint
    title: str
    unit: str
    standing: Standing
    runs: int
    violations: int
    everywhere: bool = False
    certified: bool = False
    unsearched: bool = False
    refuted: bool = False
    condition: Assumption | None = None
    confidence: float = nan

    @property
    def permitted(self) -> int | None:
        """How many test runs may be beyond the limit; None if it is on the mean."""
        return self.constraint.rule.permitted(self.runs)

    @property
    def exceeds(self) -> bool:
        """Whether more test runs are beyond the limit than it permits, be it by chance."""
        return self.permitted is not None and self.violations > self.permitted


def by_test_runs(study: Study, sample: Sample, *, unsearched: bool) -> LimitVerdict:
    """Return what the test runs of a validation say of a limit."""
    constraint = study.constraints[sample.name]
    everywhere = constraint.rule.in_every_context
    against = unsearched and everywhere and sample.violations > 0 and sample.agrees
    return LimitVerdict(
        constraint=constraint,
        title=study.limit_title(constraint),
        unit=study.metrics[constraint.metric].unit,
        standing=Standing.VIOLATED if against else sample.standing,
        runs=sample.count,
        violations=sample.violations,
        everywhere=everywhere and bool(study.contexts),
        unsearched=against,
        refuted=sample.count > 0 and not sample.agrees,
        confidence=study.certificate.confidence,
    )


def by_certificate(
    study: Study,
    constraint: Constraint,
    *,
    passed: bool,
    draws: int,
    violations: int,
    refuted: bool = False,
    condition: Assumption | None = None,
) -> LimitVerdict:
    """Return what a certificate says of a limit."""
    return LimitVerdict(
        constraint=constraint,
        title=study.limit_title(constraint),
        unit=study.metrics[constraint.metric].unit,
        standing=Standing.SHOWN if passed else Standing.VIOLATED,
        runs=draws,
        violations=violations,
        everywhere=constraint.rule.in_every_context and bool(study.contexts),
        certified=True,
        refuted=refuted,
        condition=condition if passed else None,
    )
