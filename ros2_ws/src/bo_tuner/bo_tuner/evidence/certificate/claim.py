"""What a PASS claims: in which contexts, how often, and if what holds.

What rests on counted runs, declared ranges and, where all contexts are discrete, on runs in each of
their combinations is *proven*. What else it rests on is in the claim itself.
"""

from bo_tuner.evidence.certificate.findings import Findings
from bo_tuner.evidence.facts import Claim, ClaimedLimit
from bo_tuner.study.study import Study


def claimed(study: Study, findings: Findings) -> Claim:
    """Return what findings that pass claim of their parameter set."""
    limits = [(study.constraints[found.name], found) for found in findings.constraints]
    searched = any(constraint.rule.in_every_context for constraint, _ in limits)
    conditions = (found.condition for found in findings.constraints if found.condition)
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
        conditions=tuple(dict.fromkeys(conditions)),
    )
