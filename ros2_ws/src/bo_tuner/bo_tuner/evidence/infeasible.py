"""Why no parameter set was found feasible, limit by limit, in numbers.

What a trial has against a limit is `held_against`. It breaks a limit that it violates, or keeps
with too small a margin, by its own runs. Screens and files take their words from
`words.infeasible`.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import StrEnum
from itertools import combinations

from bo_tuner.evidence.at_bounds import AtBound, at_bound
from bo_tuner.study.constraint import Constraint
from bo_tuner.study.limits import held_against, uncertain, violated
from bo_tuner.study.study import Study
from bo_tuner.trials import Trial, TrialState
from bo_tuner.tuning.prospects import Prospects

WAYS = 2
"""Ways to loosen limits that are kept."""


class Blocker(StrEnum):
    """What stands in the way."""

    DEATHS = "deaths"
    LIMITS = "limits"
    CONFLICT = "conflict"
    MARGIN = "margin"


@dataclass(frozen=True)
class Reached:
    """A value that a trial has against a limit, in the metric's unit."""

    trial: int
    value: float


@dataclass(frozen=True)
class LimitReached:
    """How the trials did on one limit.

    Attributes
    ----------
    name, title, unit
        Of the constraint; what screens call its metric, and the unit.
    limit, upper
        The limit, and whether it is an upper one.
    broke, trials
        Number of trials that broke it, of those that say something of it.
    best
        The best value of all trials; None without any.
    beside
        The best value of the trials that keep all other limits; None without any.
    """

    name: str
    title: str
    unit: str
    limit: float
    upper: bool
    broke: int
    trials: int
    best: Reached | None
    beside: Reached | None


@dataclass(frozen=True)
class Nearest:
    """The trial that is nearest to all limits at once: its largest excess over one is the smallest.

    Attributes
    ----------
    trial, limit, value
        Its number, the limit that it exceeds the most, or keeps with the least to spare, and its
        value there.
    excess
        How far that is beyond the limit, relative to the limit's size, or to the largest value of
        the trials for a limit of 0; negative if it is within.
    """

    trial: int
    limit: str
    value: float
    excess: float


@dataclass(frozen=True)
class Loosened:
    """A limit, and what it would have to be at least (an upper one) or at most (a lower one)."""

    name: str
    value: float


@dataclass(frozen=True)
class Infeasible:
    """What is known where no parameter set was found feasible.

    Attributes
    ----------
    trials, died
        Number of trials that say something, and of those that failed for their parameters.
    death
        Why most of these failed; empty without any.
    limits
        Each limit of the study.
    blocker
        What stands in the way: runs that die, limits that no trial keeps, limits that trials keep
        but none at once, or too small a margin.
    blocking
        Names of these limits.
    nearest
        The trial that is nearest to all limits at once; None without a complete one.
    loosened
        Ways to loosen limits, the smallest change first: with each of them one trial keeps all
        limits by its own runs.
    chance
        Largest probability with which a parameter set within the bounds keeps all limits by the
        models; NaN if they were not asked.
    beyond
        Bounds beyond which the models expect feasible sets.
    fresh_deaths
        Number of test runs of the recommended set that failed in its validation.
    """

    trials: int
    died: int
    death: str
    limits: tuple[LimitReached, ...]
    blocker: Blocker
    blocking: tuple[str, ...]
    nearest: Nearest | None
    loosened: tuple[tuple[Loosened, ...], ...]
    chance: float = math.nan
    beyond: tuple[AtBound, ...] = ()
    fresh_deaths: int = 0

    def of(self, name: str) -> LimitReached:
        """Return how the trials did on a limit."""
        return next(item for item in self.limits if item.name == name)


@dataclass(frozen=True)
class _Judged:
    trial: int
    values: dict[str, float]
    broken: frozenset[str]


def infeasible(
    study: Study,
    trials: Sequence[Trial],
    prospects: Prospects | None = None,
    refuted: Sequence[str] = (),
    fresh_deaths: int = 0,
) -> Infeasible:
    """Return why no parameter set was found feasible."""
    counted = [trial for trial in trials if not trial.unusable]
    deaths = [trial.reason for trial in counted if trial.state is TrialState.FAILED]
    judged = [_judged(study, t) for t in counted if t.state is not TrialState.FAILED]
    reached = tuple(_reached(study, c, judged) for c in study.constraints.values())
    blocker, blocking = _blocking(judged, len(deaths), reached, refuted)
    sizes = {name: _size(constraint, judged) for name, constraint in study.constraints.items()}

    def excess(name: str, value: float) -> float:
        constraint = study.constraints[name]
        return constraint.sign * (value - constraint.limit) / sizes[name]

    nearest = min(
        (_nearest(item, excess) for item in judged if item.values),
        key=lambda item: (item.excess, item.trial),
        default=None,
    )
    return Infeasible(
        trials=len(counted),
        died=len(deaths),
        death=max(deaths, key=deaths.count, default=""),
        limits=reached,
        blocker=blocker,
        blocking=blocking,
        nearest=nearest,
        loosened=() if blocker is Blocker.MARGIN else _loosened(reached, judged, nearest, excess),
        chance=math.nan if prospects is None else prospects.chance,
        beyond=() if prospects is None else _beyond(study, prospects),
        fresh_deaths=fresh_deaths,
    )


def _judged(study: Study, trial: Trial) -> _Judged:
    if trial.state is TrialState.CUT_SHORT:
        known = [e.outcome.notes.at_least for e in trial.evaluations]
        over = (
            name
            for name, constraint in study.constraints.items()
            if any(constraint.violations(each.get(constraint.metric, math.nan)) for each in known)
        )
        return _Judged(trial.number, {}, frozenset(over))
    values = {
        name: value
        for name, constraint in study.constraints.items()
        if math.isfinite(value := held_against(constraint, trial))
    }
    broken = frozenset((*violated(study, trial), *uncertain(study, trial)))
    return _Judged(trial.number, values, broken)


def _size(constraint: Constraint, judged: Sequence[_Judged]) -> float:
    """Return what an excess is relative to: a limit of 0 has no size, the values have."""
    values = [abs(item.values.get(constraint.name, 0.0)) for item in judged]
    return abs(constraint.limit) or max(values, default=0.0) or 1.0


def _nearest(item: _Judged, excess: Callable[[str, float], float]) -> Nearest:
    by_limit = {name: excess(name, value) for name, value in item.values.items()}
    most = max(by_limit, key=lambda name: by_limit[name])
    return Nearest(item.trial, most, item.values[most], by_limit[most])


def _reached(study: Study, constraint: Constraint, judged: Sequence[_Judged]) -> LimitReached:
    name = constraint.name

    def best(of: Sequence[_Judged]) -> Reached | None:
        each = [Reached(item.trial, item.values[name]) for item in of if name in item.values]
        return min(each, key=lambda item: constraint.sign * item.value, default=None)

    known = [item for item in judged if name in item.values or name in item.broken]
    metric = study.metrics[constraint.metric]
    return LimitReached(
        name=name,
        title=study.limit_title(constraint),
        unit=metric.unit,
        limit=constraint.limit,
        upper=constraint.sign > 0.0,
        broke=sum(name in item.broken for item in known),
        trials=len(known),
        best=best(known),
        beside=best([item for item in known if item.broken <= {name}]),
    )


def _blocking(
    judged: Sequence[_Judged],
    died: int,
    limits: Sequence[LimitReached],
    refuted: Sequence[str],
) -> tuple[Blocker, tuple[str, ...]]:
    """Return what stands in the way, and which limits these are."""
    if died > len(judged) or not judged:
        return Blocker.DEATHS, ()
    never_kept = tuple(item.name for item in limits if item.trials and item.broke == item.trials)
    if never_kept:
        return Blocker.LIMITS, never_kept
    if not all(item.broken for item in judged):
        return Blocker.MARGIN, tuple(refuted)
    # Each is kept by some trial. Two of them may be enough of a reason.
    broken = [item.name for item in limits if item.broke]
    pairs = (p for p in combinations(broken, 2) if all(item.broken & {*p} for item in judged))
    return Blocker.CONFLICT, next(pairs, tuple(broken))


def _loosened(
    limits: Sequence[LimitReached],
    judged: Sequence[_Judged],
    nearest: Nearest | None,
    excess: Callable[[str, float], float],
) -> tuple[tuple[Loosened, ...], ...]:
    """Return the ways of one limit alone, and that of all limits that the nearest trial broke."""
    if nearest is None:
        return ()
    (of_nearest,) = (item for item in judged if item.trial == nearest.trial)
    names = [item.name for item in limits if item.name in of_nearest.broken]
    ways = [tuple(Loosened(name, of_nearest.values[name]) for name in names)]
    for item in limits:
        if item.broke and item.beside is not None:
            ways.append((Loosened(item.name, item.beside.value),))

    def change(way: tuple[Loosened, ...]) -> float:
        return max(excess(item.name, item.value) for item in way)

    return tuple(sorted(dict.fromkeys(ways), key=change)[:WAYS])


def _beyond(study: Study, prospects: Prospects) -> tuple[AtBound, ...]:
    known = [at_bound(study.parameters[each.parameter], each.side) for each in prospects.beyond]
    return tuple(bound for bound in known if bound.wider is not None)
