"""What screens and files say of a run without a feasible parameter set, from the facts."""

from collections.abc import Iterator, Sequence
from math import ceil, floor, isnan, log10

from bo_tuner.evidence.infeasible import Blocker, Infeasible, LimitReached, Loosened
from bo_tuner.text import counted, listed, percent, shown_beside

SMALL = 0.05
"""Chance below which more trials are not the first thing to try."""
LITTLE = 0.2
"""Share of its limit up to which a value that is within it has little to spare."""


def blocker_in_words(facts: Infeasible) -> str:
    """Return what stands in the way, without a full stop."""
    titles = [facts.of(name).title for name in facts.blocking]
    match facts.blocker:
        case Blocker.DEATHS:
            return f"{facts.died} of {counted(facts.trials, 'trial')} failed: {facts.death}"
        case Blocker.LIMITS:
            return f"no trial keeps {limits_of(titles)}"
        case Blocker.CONFLICT:
            conflict = f"{limits_of(titles)} are in conflict"
            return f"{conflict}: trials keep each, but none keeps all of them"
        case Blocker.MARGIN:
            why = "the models are not sure enough of any"
            if titles:
                why = f"fresh test runs broke {limits_of(titles)}"
            if facts.fresh_deaths:
                why = f"{facts.fresh_deaths} of the fresh test runs failed"
            return f"trials kept all limits in their own runs, but {why}"


def limits_of(titles: Sequence[str]) -> str:
    """Return limits by what they are called; empty without any."""
    return f"the limit{'s' * (len(titles) > 1)} of {listed(titles)}" if titles else ""


def reasons_in_words(facts: Infeasible) -> tuple[str, ...]:
    """Return sentences on each limit of which trials tell, and on the nearest trial."""
    blocks = []
    if facts.died and facts.blocker is not Blocker.DEATHS:
        blocks.append(f"{facts.died} of {counted(facts.trials, 'trial')} failed: {facts.death}.")
    known = (_of_limit(item) for item in facts.limits if item.trials)
    return (*blocks, *known, *_nearest(facts))


def advice_in_words(facts: Infeasible) -> tuple[str, ...]:
    """Return what to do, in sentences, the most promising first."""
    steps = [] if isnan(facts.chance) else [_of_more_trials(facts)]
    steps = [*steps, *_of_limits(facts)] if promising(facts) else [*_of_limits(facts), *steps]
    if facts.blocker is Blocker.DEATHS:
        steps.insert(0, "See why test runs fail first: replay and the logs of the nodes say more.")
    steps += [
        f"The models expect feasible parameter sets beyond the {bound.side} bound of "
        f"{bound.title}: widen that range."
        for bound in facts.beyond
    ]
    return tuple(steps)


def promising(facts: Infeasible | None) -> bool:
    """Return whether more trials are what to try first, as far as that is known."""
    return facts is None or not facts.chance < SMALL


def half_as_many_again(facts: Infeasible) -> int:
    """Return how many trials in all a run may be continued to."""
    return facts.trials + ceil(facts.trials / 2)


def _of_limit(item: LimitReached) -> str:
    broke = f"{item.broke} of {counted(item.trials, 'trial')} over the limit {_limit(item)}"
    text = f"{item.title}: {broke}"
    if item.best is not None:
        text += f"; the best has {_value(item, item.best.value)} (trial {item.best.trial})"
    if item.beside is not None and item.beside != item.best:
        beside = f"{_value(item, item.beside.value)} (trial {item.beside.trial})"
        text += f", of those within all other limits {beside}"
    return f"{text}."


def _nearest(facts: Infeasible) -> Iterator[str]:
    nearest = facts.nearest
    if nearest is None:
        return
    item = facts.of(nearest.limit)
    worst = "is farthest over" if nearest.excess > 0.0 else "has the least to spare"
    yield (
        f"Nearest to all limits in its own runs: trial {nearest.trial}, whose {item.title} {worst} "
        f"({_value(item, nearest.value)}, limit {_limit(item)})."
    )


def _of_more_trials(facts: Infeasible) -> str:
    chance = percent(facts.chance)
    if not promising(facts):
        return (
            "More trials promise little: by the models, the best parameter set within the bounds "
            f"is {chance} likely to keep all limits."
        )
    return (
        f"Run more trials: by the models, the best parameter set within the bounds is {chance} "
        "likely to keep all limits."
    )


def _of_limits(facts: Infeasible) -> Iterator[str]:
    if facts.loosened:
        ways = (" and ".join(_loosened(facts, item) for item in way) for way in facts.loosened)
        yield f"Loosen {', or '.join(ways)}."
    elif facts.blocker is Blocker.MARGIN and (nearest := facts.nearest) is not None:
        if nearest.excess < -LITTLE:
            number = nearest.trial
            yield f"Trial {number} has much to spare: validate --trial {number} tests it."
        else:
            title = facts.of(nearest.limit).title
            yield f"Loosen the limit of {title}, which leaves the least to spare."


def _loosened(facts: Infeasible, item: Loosened) -> str:
    limit = facts.of(item.name)
    side = "at least" if limit.upper else "at most"
    value = f"{_outwards(item.value, limit.upper):.3g} {limit.unit}".rstrip()
    return f"the limit of {limit.title} to {side} {value}"


def _outwards(value: float, upper: bool) -> float:
    """Round a number to three digits, so that a limit there is not tighter."""
    if value == 0.0:
        return value
    step = 10.0 ** (floor(log10(abs(value))) - 2)
    return step * (ceil(value / step) if upper else floor(value / step))


def _value(item: LimitReached, value: float) -> str:
    return f"{shown_beside(value, item.limit)} {item.unit}".rstrip()


def _limit(item: LimitReached) -> str:
    return f"{item.limit:g} {item.unit}".rstrip()
