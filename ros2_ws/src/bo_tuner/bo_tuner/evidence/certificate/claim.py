"""What a certificate says in facts: what a PASS claims, and what speaks against a PASS.

What rests on counted runs, declared ranges and, where all contexts are discrete, on runs in each of
their combinations is *proven*. What else it rests on is in the claim itself.
"""

from collections.abc import Iterator, Mapping

from bo_tuner.evidence.certificate.certificate import Certificate
from bo_tuner.evidence.certificate.findings import Findings, Refutation
from bo_tuner.evidence.facts import (
    Claim,
    ClaimedLimit,
    Contradiction,
    EvidenceMissing,
    Fact,
    FailedBefore,
    FirstFailure,
    NotShown,
    RefutedInRun,
    Seen,
)
from bo_tuner.study.measured import SeenRange
from bo_tuner.study.study import Study


def claimed(study: Study, findings: Findings) -> Claim:
    """Return what findings that pass claim of their parameter set."""
    limits = [(study.constraints[found.name], found) for found in findings.constraints]
    searched = any(constraint.rule.in_every_context for constraint, _ in limits)
    assumed = [found.assumption for found in findings.constraints]
    return Claim(
        searched=searched and not study.context_space().is_discrete,
        limits=tuple(
            ClaimedLimit(
                constraint,
                study.limit_title(constraint),
                over=found.violations + sum(context.beyond for context in found.worst),
                runs=found.draws + sum(context.evaluations for context in found.worst),
            )
            for constraint, found in limits
            if constraint.rule.on_runs
        ),
        conditions=tuple(dict.fromkeys(each for each in assumed if each is not None)),
    )


def objections(study: Study, findings: Findings) -> tuple[Fact, ...]:
    """Return why a parameter set does not pass; empty if it does."""
    found: list[Fact] = []
    if findings.first_failure is not None:
        first = findings.first_failure
        found.append(FirstFailure(findings.failures, findings.evaluations, first))
    if findings.contradiction is not None:
        found.append(Contradiction(findings.contradiction))
    for limit in findings.constraints:
        if not limit.passed:
            found.append(NotShown(study.limit_title(study.constraints[limit.name]), limit))
    return tuple(found)


def failed_before(study: Study, certificate: Certificate) -> Iterator[Fact]:
    """Yield on what its parameter set had failed before, and which evidence is missing."""
    for refutation in certificate.earlier.refutations:
        yield FailedBefore(refutation, _refuted_by(study, refutation), certificate.passed)
    yield from map(EvidenceMissing, certificate.earlier.unread)


def _refuted_by(study: Study, refutation: Refutation) -> tuple[Fact, ...]:
    if refutation.findings is not None:
        return objections(study, refutation.findings)
    if (runs := refutation.runs) is None:
        return ()
    title = study.limit_title(study.constraints[runs.constraint])
    return (RefutedInRun(title, runs.runs, runs.contexts),)


def seen(study: Study, ranges: Mapping[str, SeenRange]) -> Iterator[Seen]:
    """Yield what runs have seen of each measured context: nothing is claimed beyond."""
    for name, of_runs in ranges.items():
        yield Seen(study.metrics[name].title, study.metrics[name].unit, of_runs)
