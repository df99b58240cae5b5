"""What runs show of the limits before they decide a certificate.

The bounds hold after every run at once, so they may be looked at whenever somebody has no time for
more.
"""

from collections.abc import Iterator

from bo_tuner import text
from bo_tuner.evidence.certificate.findings import ConstraintVerdict, Evidence, widest
from bo_tuner.evidence.certificate.judgement import judge
from bo_tuner.evidence.words.reasons import reason
from bo_tuner.study.constraint import Constraint
from bo_tuner.study.study import Study


def so_far(study: Study, evidence: Evidence, confidence: float) -> Iterator[str]:
    """Yield what the runs of an undecided certificate show, a line for each limit."""
    runs = text.counted(len(evidence.evaluations), "test run")
    if not evidence.drawn:
        yield f"nothing is shown by {runs}"
        return
    findings = judge(study, evidence, confidence)
    refuting = findings.failures or findings.contradiction
    yield (
        f"{runs}, {'some speak against it' if refuting else 'nothing refutes it'}; shown with "
        f"{100.0 * confidence:.4g} % confidence:"
    )
    for found in findings.constraints:
        constraint = study.constraints[found.name]
        yield f"{study.limit_title(constraint)}: {_shown(study, constraint, found, evidence)}"


def _shown(
    study: Study, constraint: Constraint, found: ConstraintVerdict, evidence: Evidence
) -> str:
    if not constraint.rule.in_every_context:
        if constraint.rule.on_runs:
            return _share(found.violation_bound, constraint)
        return reason(found)
    where = "in random contexts; the search for its worst one is not done"
    if not evidence.repeated:
        return f"{_share(found.violation_bound, constraint)} {where}"
    contexts = found.worst
    # Of contexts that may be the worst, with those in which nothing was run yet.
    every = len(contexts) + evidence.unvisited.get(found.name, 0)
    if not contexts:
        return f"nothing in the {every} contexts that may be the worst"
    of = f"in {len(contexts)} of {every} contexts that may be the worst" if study.contexts else ""
    if constraint.rule.on_runs:
        return f"{_share(max(w.violation_bound for w in contexts), constraint)} {of}".rstrip()
    bound = widest(constraint.side, (w.mean.bound(constraint.side) for w in contexts))
    limit = f"limit {constraint.limit:g} {found.unit}".rstrip()
    if not constraint.violations(bound):
        most = "at most" if constraint.sign > 0.0 else "at least"
        mean = f"{most} {text.shown_beside(bound, constraint.limit)}"
        return f"a mean over noise of {mean} {of}, {limit}"
    runs = text.counted(sum(w.evaluations for w in contexts), "run")
    return f"nothing of the mean over noise by {runs} {of}, {limit}"


def _share(bound: float, constraint: Constraint) -> str:
    """Say which share of the runs keeps a limit, by the bound of the probability of a violation."""
    side = "below" if constraint.sign > 0.0 else "above"
    asked = f", asked {constraint.level:g}" if constraint.rule.on_runs else ""
    return f"at least {_down(1.0 - bound)} of the runs are {side} {constraint.limit:g}{asked}"


def _down(share: float) -> str:
    """Return a share in two digits, or three close to 1, rounded down: what is shown is as much."""
    digits = 2 if share < 0.99 else 4
    return f"{int(share * 10**digits) / 10**digits:g}"
