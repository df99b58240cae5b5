"""What was found of one limit, in numbers and in words.

Few test runs cannot show that a limit is kept: they are counted, beside how many violations the
limit permits. *Kept* is only what is shown, and it stands with what the limit permits.
"""

from dataclasses import dataclass

from bo_tuner.evidence.limit_words import words_of
from bo_tuner.study.constraint import Constraint
from bo_tuner.study.limits import Sample, Standing
from bo_tuner.study.study import Study
from bo_tuner.text import counted


@dataclass(frozen=True)
class LimitVerdict:
    """What was found of a limit.

    Attributes
    ----------
    standing
        Whether it is proven to be kept, open, or violated.
    runs, violations
        Number of test runs, and of those beyond the limit.
    permitted
        How many of them may be; None if the limit is on the mean.
    asked
        How often it must be kept, such as ``in 90 % of the runs``.
    evidence
        What was counted, in words; empty for a certificate, which has more to say.
    words
        What was found, in words that follow those of the limit.
    refuted
        Whether the runs show that the limit is not kept; else a violated one is not proven.
    condition
        What it rests on that runs do not prove, in words that follow *if*; else empty.
    """

    standing: Standing
    runs: int
    violations: int
    permitted: int | None
    asked: str
    evidence: str
    words: str
    refuted: bool = False
    condition: str = ""

    @property
    def exceeds(self) -> bool:
        """Whether more test runs are beyond the limit than it permits, be it by chance."""
        return self.permitted is not None and self.violations > self.permitted


def asked(study: Study, constraint: Constraint) -> str:
    """Return how often a limit must be kept, in a few words."""
    everywhere = constraint.rule.in_every_context and bool(study.contexts)
    return words_of(constraint).asked(everywhere=everywhere)


def by_test_runs(study: Study, sample: Sample, *, unsearched: bool) -> LimitVerdict:
    """Return what the test runs of a validation say of a limit.

    Parameters
    ----------
    study
        The study.
    sample
        The limit's metric in the complete test runs.
    unsearched
        Whether a limit in every context must rest on them alone, as nobody searched for the worst
        one; then a single one beyond the limit, which does not refute it, counts against it, too.
    """
    constraint = study.constraints[sample.name]
    standing, how_often = sample.standing, asked(study, constraint)
    evidence = _counted(constraint, sample)
    words = evidence
    everywhere = constraint.rule.in_every_context
    if unsearched and sample.violations and sample.agrees and everywhere:
        standing = Standing.VIOLATED
        evidence += " (no search was made for its worst context)"
        words = f"NOT proven to be kept: {evidence}"
    elif not sample.count:
        words = f"NOT proven to be kept: {evidence}"
    elif not sample.agrees:
        words = f"NOT kept: {evidence}"
    elif standing is Standing.SHOWN:
        confidence = f"{100.0 * study.certificate.confidence:g} % confidence"
        words = f"proven to be kept {how_often}: {evidence} ({confidence})"
    elif sample.permitted is not None and sample.violations > sample.permitted:
        words = evidence = f"{evidence}, which may be chance"
    return LimitVerdict(
        standing,
        sample.count,
        sample.violations,
        sample.permitted,
        how_often,
        evidence,
        words,
        refuted=sample.count > 0 and not sample.agrees,
    )


def by_certificate(
    study: Study,
    constraint: Constraint,
    *,
    passed: bool,
    draws: int,
    violations: int,
    refuted: bool = False,
    condition: str = "",
) -> LimitVerdict:
    """Return what a certificate says of a limit."""
    how_often = asked(study, constraint)
    words = f"{'' if passed else 'NOT '}proven to be kept {how_often}"
    if passed and condition:
        words = f"shown to stay within it {how_often}, if {condition}"
    return LimitVerdict(
        Standing.SHOWN if passed else Standing.VIOLATED,
        draws,
        violations,
        constraint.rule.permitted(draws),
        how_often,
        "",
        words,
        refuted=refuted,
        condition=condition if passed else "",
    )


def _counted(constraint: Constraint, sample: Sample) -> str:
    """Return how many test runs are beyond a limit, and how many may be."""
    if not sample.count:
        return "no test run is complete"
    runs = counted(sample.count, "test run")
    return words_of(constraint).counted(sample.violations, runs, sample.count, agrees=sample.agrees)
