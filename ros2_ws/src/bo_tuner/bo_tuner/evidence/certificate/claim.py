"""What a PASS claims, in words: proven or shown, in which contexts, how often, and if what holds.

*Proven* rests on counted runs, declared ranges and, where all contexts are discrete, on runs in
each of their combinations. What else it rests on is in the claim itself.
"""

from collections.abc import Iterator

from bo_tuner import text
from bo_tuner.evidence.certificate.findings import ConstraintVerdict, Findings
from bo_tuner.evidence.limit_words import words_of
from bo_tuner.evidence.verdict import WITHIN
from bo_tuner.study.study import Study


def claimed(study: Study, findings: Findings) -> str:
    """Return what findings that pass claim of their parameter set."""
    limits = [(study.constraints[found.name], found) for found in findings.constraints]
    searched = any(constraint.rule.in_every_context for constraint, _ in limits)
    where = " in the contexts searched" * (searched and not study.context_space().is_discrete)
    shares = [
        _share(found, words_of(constraint).asked(everywhere=False), constraint.beyond)
        for constraint, found in limits
        if constraint.rule.on_runs
    ]
    among = f", {'; '.join(shares)}" if shares else ""
    conditions = tuple(dict.fromkeys(_conditions(findings)))
    if not conditions:
        return f"{WITHIN}{where}{among}"
    return f"shown to stay within all limits{where}{among}, if {' and '.join(conditions)}"


def _share(found: ConstraintVerdict, how_often: str, beyond: str) -> str:
    """Say how often a limit on single runs is kept, and how many runs were beyond it."""
    over = found.violations + sum(context.beyond for context in found.worst)
    runs = found.draws + sum(context.evaluations for context in found.worst)
    counted = f" ({over} of {text.counted(runs, 'test run')} {beyond} it)" if over else ""
    return f"{found.name} {how_often}{counted}"


def _conditions(findings: Findings) -> Iterator[str]:
    for constraint in findings.constraints:
        if constraint.condition:
            yield constraint.condition
