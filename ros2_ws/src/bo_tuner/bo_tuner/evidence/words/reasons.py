"""What is said of why a certificate shows a limit, or does not, and of what that rests on."""

from math import isfinite

from bo_tuner import text
from bo_tuner.evidence.certificate.findings import ConstraintVerdict, WorstContext
from bo_tuner.evidence.reasons import Assumption, Reason, Why
from bo_tuner.numerics.two_kinds import RARE
from bo_tuner.study.limit_kinds.limited import UPPER

NOISE = (
    f"the noise is normal or log-normal, without a second kind of runs in less than "
    f"{100.0 * RARE:g} % of them; to be sure give the metric a range, or limit single runs "
    "(probability)"
)
"""Assumption of a certificate of a mean if its metric has no range; the level is measured by
benchmarks/repeated_certificates.py and benchmarks/false_passes.py."""
FRESH = "test run"


def proven(found: ConstraintVerdict) -> str:
    """Return whether a limit is proven, in a few words."""
    if not found.passed:
        return "NOT proven"
    return "proven" if found.assumption is None else f"shown, if {condition(found.assumption)}"


def assumption(assumed: Assumption) -> str:
    """Return on what a limit rests besides the runs that are counted."""
    if assumed.repeats is None:
        return NOISE
    return (
        "the study declares its runs free of noise (noise: none), of which "
        f"{text.counted(assumed.repeats, 'run')} with another seed had the same metrics"
    )


def condition(assumed: Assumption) -> str:
    """Return the same in a few words that follow *if*."""
    if assumed.repeats is None:
        return f"no rare runs are far beyond the {assumed.title} of the others"
    return "its runs are free of noise, as declared"


def reason(found: ConstraintVerdict) -> str:
    """Return why a limit is shown, or not, as a clause."""
    why, beyond = found.reason, found.violations + found.failures
    match why.why:
        case Why.SHARE:
            fewest = f" ({why.needed} {FRESH}s without any are needed)"
            needed = fewest if found.draws < why.needed else ""
            violating = f"{_violating(beyond, found.draws)} or fail{needed}"
            return f"{violating}: {_probability(found, found.violation_bound)}"
        case Why.MEAN:
            over = "mean over contexts and noise"
            if isfinite(why.bound):
                return f"{over} {_bounded(found, why.bound)}"
            return f"too few {FRESH}s ({found.draws - found.failures}) to bound the {over}"
        case Why.TWO_KINDS:
            return _two_kinds(found, f"{FRESH}s")
        case Why.WITHOUT_NOISE:
            return (
                f"{_violating(beyond, found.draws)} or fail, and there is neither noise nor "
                "another context"
            )
        case Why.EARLIER:
            return _together(found, why.earlier, "", found.draws, why.together)
        case Why.DRAWS:
            return (
                f"{_violating(beyond, found.draws)} or fail: more than a limit allows that is kept "
                "in every context"
            )
        case Why.NOT_RUN:
            if not why.not_run:
                return "its worst contexts were not run"
            contexts = text.counted(why.not_run, "context")
            return f"{contexts} that may be the worst had no run, as another one had decided"
        case Why.FAILED:
            failed = text.counted(sum(context.failures for context in found.worst), FRESH)
            return f"{failed} failed in the worst contexts (none is allowed)"
    return _in_context(found, why, found.worst[why.place])


def _in_context(found: ConstraintVerdict, why: Reason, context: WorstContext) -> str:
    """Return what the runs in the context that decides show."""
    inside = text.values(context.context)
    alone = f" in a context ({inside})" if inside else ""
    which = "the least certain of the worst contexts" if why.place else "the worst context"
    where = f"in {which} ({inside}) " if inside else ""
    match why.why:
        case Why.EARLIER_IN_CONTEXT:
            fresh = context.evaluations + context.failures
            return _together(found, context.earlier, alone, fresh, context.together)
        case Why.SHARE_IN_CONTEXT:
            violating = _violating(context.beyond, context.evaluations)
            return f"{where}{violating}: {_probability(found, context.violation_bound)}"
        case Why.REFUTED_IN_CONTEXT:
            return (
                f"mean over noise{alone} is {text.shown_beside(context.mean.value, found.limit)}, "
                f"{_limit(found)}: {context.evaluations} {FRESH}s show that it is not kept"
            )
        case Why.TWO_KINDS_IN_CONTEXT:
            return _two_kinds(found, f"{FRESH}s {where}".rstrip())
    bound = context.mean.bound(found.side)
    if not isfinite(bound):
        return f"too few {FRESH}s ({context.evaluations}) {where}to bound the mean over noise"
    return f"mean over noise {where}{_bounded(found, bound)}"


def _violating(beyond: int, runs: int) -> str:
    return f"{beyond} of {text.counted(runs, FRESH)} violate the limit"


def _limit(found: ConstraintVerdict) -> str:
    return f"limit {found.limit:g} {found.unit}".rstrip()


def _probability(found: ConstraintVerdict, bound: float) -> str:
    """Return the bound of the probability of a violation beside what is allowed."""
    return (
        f"violation probability {'at most' if found.passed else 'may be'} "
        f"{text.shown_beside(bound, found.allowed)}, allowed {found.allowed:.4g}"
    )


def _bounded(found: ConstraintVerdict, bound: float) -> str:
    """Return the bound of a mean beside the limit."""
    says = "may be"
    if found.passed:
        says = "at most" if found.side == UPPER else "at least"
    return f"{says} {text.shown_beside(bound, found.limit)}, {_limit(found)}"


def _two_kinds(found: ConstraintVerdict, runs: str) -> str:
    return (
        f"the {runs} are of two kinds, so that only a range bounds their mean: give "
        f"metrics.{found.metric} a range, or limit single runs (probability)"
    )


def _together(
    found: ConstraintVerdict, earlier: int, where: str, fresh: int, together: float
) -> str:
    """Return that earlier runs and fresh ones together break the limit."""
    runs = text.counted(earlier, f"earlier {FRESH}")
    both = f"{runs}{where}, which count against it, and {fresh} fresh ones together"
    if found.allowed < 1.0:
        share = text.shown_beside(together, found.allowed)
        return f"{both} violate the limit with a share of {share}, allowed {found.allowed:.4g}"
    mean = text.shown_beside(together, found.limit)
    return f"{both} have a mean of {mean}, limit {found.limit:g}"
