"""Runs that show what each tuned parameter does: the default, and parameter sets around it.

One parameter at a time is moved from the default. Numbers beyond `MOST_SINGLY` are moved all at
once instead, in a screening design, which takes fewer runs for the same noise. In small steps a
number is moved by one, see `SearchSpace.neighbours`, and what has no steps is not tried; over the
whole range it takes its ends, in a screening design the values half of the way to them, since of
many ends together hardly any run is completed.

The test is that of `numerics.linear_effects`. Of a parameter that does nothing all runs compared
are alike, whatever the other parameters do, so that its level holds for normal noise of any size.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from bo_tuner.numerics.arrays import Array
from bo_tuner.numerics.hadamard import screening_design
from bo_tuner.numerics.linear_effects import NOTHING_KNOWN, LinearEffect, linear_effect
from bo_tuner.numerics.seeds import Stream, generator
from bo_tuner.study.search_space import SearchSpace
from bo_tuner.study.study import Study
from bo_tuner.trials import Evaluation, Value
from bo_tuner.tuning.effects import FAILURES, Effect, ParameterEffects, test_level

DEFAULT_RUNS = 8
"""Runs of the default, with which the others are compared."""
REPEATS = 2
"""Runs of each value of a parameter that is moved alone."""
MOST_SINGLY = 8
"""Numbers that are moved one at a time."""


@dataclass(frozen=True)
class Variation:
    """A parameter set around the default.

    Attributes
    ----------
    parameters
        The parameter set.
    moved
        The only tuned parameter that differs from the default; empty in a screening design.
    runs
        How often it is run.
    """

    parameters: Mapping[str, Value]
    moved: str
    runs: int


@dataclass(frozen=True)
class Variations:
    """What is to be run.

    Attributes
    ----------
    variations
        The parameter sets, beside the default.
    values
        Values beside the default that each tuned parameter is given, which is tried with them.
    screened
        The parameters that are moved at once.
    """

    variations: tuple[Variation, ...]
    values: Mapping[str, tuple[Value, ...]]
    screened: tuple[str, ...]

    @property
    def runs(self) -> int:
        """Number of runs, without those of the default."""
        return sum(variation.runs for variation in self.variations)


@dataclass(frozen=True)
class Move:
    """An effect that was seen.

    Attributes
    ----------
    effect
        The effect; its change is to the value from the default, or in a screening design from the
        lower value.
    value
        The value of the parameter where it is largest.
    noise
        Standard deviation of a run's noise, in the metric's unit; NaN where it is not known.
    """

    effect: Effect
    value: Value
    noise: float


@dataclass(frozen=True)
class Found:
    """What the runs show of a parameter.

    Attributes
    ----------
    effects
        Its effects.
    moves
        Those that were seen.
    """

    effects: ParameterEffects
    moves: tuple[Move, ...]


@dataclass
class VariedRuns:
    """Runs that have ended, without unusable ones.

    Attributes
    ----------
    default
        Of the default.
    varied
        By the place of their variation in the plan.
    """

    default: list[Evaluation]
    varied: dict[int, list[Evaluation]] = field(default_factory=dict)


def plan(study: Study, *, whole_range: bool) -> Variations:
    """Plan the runs around the default of a study."""
    space = study.search_space()
    singly = _single(space, whole_range=whole_range)
    numbers = [name for name in space.numbers if name in singly]
    screened = tuple(numbers) if len(numbers) > MOST_SINGLY else ()
    variations = [
        Variation(space.completed({**space.defaults, name: value}), name, REPEATS)
        for name, values in singly.items()
        if name not in screened
        for value in values
    ]
    if screened:
        levels = {n: _levels(space, n, singly[n], whole_range=whole_range) for n in screened}
        singly |= levels
        rng = generator(study.seed, Stream.EFFECTS, 1)
        for row in screening_design(len(screened), rng):
            chosen = {n: levels[n][int(sign > 0.0)] for n, sign in zip(screened, row, strict=True)}
            point = space.repair(space.to_cube({**space.defaults, **chosen})[None])[0]
            variations.append(Variation(space.to_parameters(point), "", 1))
    return Variations(tuple(variations), singly, screened)


def _single(space: SearchSpace, *, whole_range: bool) -> dict[str, tuple[Value, ...]]:
    """Return the values of each parameter that is moved alone."""
    values_of: dict[str, list[Value]] = {name: [] for name in space.names}
    for neighbour in space.neighbours(space.defaults):
        moved = [name for name in space.names if neighbour[name] != space.defaults[name]]
        # One of two that are kept in order may move the other.
        if len(moved) == 1 and (whole_range or moved[0] in space.numbers):
            values_of[moved[0]].append(neighbour[moved[0]])
    if whole_range:
        inactive = space.inactive(space.defaults)
        values_of |= {name: _ends(space, name) for name in space.numbers if name not in inactive}
    return {name: tuple(values) for name, values in values_of.items() if values}


def _ends(space: SearchSpace, name: str) -> list[Value]:
    """Return the least and the largest value of a number beside the default of the others."""
    default, column = space.defaults, space.names.index(name)
    least, most = -np.inf, np.inf
    for lower, upper in space.order:
        if upper == name:
            least = max(least, float(default[lower]))
        if lower == name:
            most = min(most, float(default[upper]))
    ends = [max(float(space.lower[column]), least), min(float(space.upper[column]), most)]
    (item,) = (item for item in space.parameters if item.name == name)
    # The last value of a grid may lie within the bound.
    numbers = map(item.on_grid, ends)
    values: list[Value] = [round(n) if item.is_integer else n for n in numbers]
    return [value for value in dict.fromkeys(values) if value != default[name]]


def _levels(
    space: SearchSpace, name: str, values: Sequence[Value], *, whole_range: bool
) -> tuple[Value, Value]:
    """Return the lower and the upper value of a number in a screening design."""
    default = space.defaults[name]
    column = space.names.index(name)
    if whole_range:
        cube = [space.to_cube({**space.defaults, name: v})[column] for v in (default, *values)]
        halfway = []
        for end, value in zip(cube[1:], values, strict=True):
            point = space.to_cube(space.defaults)
            point[column] = 0.5 * (cube[0] + end)
            half = space.to_parameters(space.repair(point[None])[0])[name]
            halfway.append(value if half == default else half)
        values = halfway
    # A default at a bound is one of the two.
    both = sorted([*values, default][:2] if len(values) < 2 else values, key=float)
    return both[0], both[-1]


def order_of_runs(study: Study, planned: Variations, default_runs: int) -> list[int | None]:
    """Return the runs in random order, so that a drift of the machine is no effect."""
    places: list[int | None] = [None] * default_runs
    for place, variation in enumerate(planned.variations):
        places += [place] * variation.runs
    order = generator(study.seed, Stream.EFFECTS, 2).permutation(len(places))
    return [places[k] for k in order.tolist()]


def judge(study: Study, planned: Variations, runs: VariedRuns) -> dict[str, Found]:
    """Return what the runs show of each parameter that was tried, by its name."""
    level = test_level(study, len(study.responses))
    at_once = [
        evaluation
        for place, variation in enumerate(planned.variations)
        if not variation.moved
        for evaluation in runs.varied.get(place, [])
    ]
    points = study.search_space().cube_of(evaluation.parameters for evaluation in at_once)
    return {
        name: _screened(study, planned, at_once, points, name, level)
        if name in planned.screened
        else _singly(study, planned, runs, name, level)
        for name in planned.values
    }


def _singly(study: Study, planned: Variations, runs: VariedRuns, name: str, level: float) -> Found:
    """Return what a parameter does that was moved alone."""
    own = {
        variation.parameters[name]: runs.varied.get(place, [])
        for place, variation in enumerate(planned.variations)
        if variation.moved == name
    }
    complete = {value: _complete(done) for value, done in own.items()}
    base = _complete(runs.default)
    groups = {value: done for value, done in complete.items() if done}
    counts = [len(base), *map(len, groups.values())]
    factor = np.repeat(np.eye(len(counts)), counts, axis=0)[:, 1:]
    each = {}
    for metric in study.responses:
        y = _values([base, *groups.values()], metric)
        test = _tested(y, np.ones((len(y), 1)), factor, np.eye(len(groups)), level)
        each[metric] = (test, [*groups, *own][test.contrast])
    result = _from_tests(study, name, each, level)
    failing = [value for value, done in own.items() if len(done) >= REPEATS and not complete[value]]
    if failing and len(base) == len(runs.default):
        effect = Effect(FAILURES, "", seen=True, change=1.0, visible=1.0)
        move = Move(effect, failing[0], float("nan"))
        effects = replace(result.effects, effects=(*result.effects.effects, effect))
        result = Found(effects, (*result.moves, move))
    return result


def _screened(
    study: Study,
    planned: Variations,
    done: Sequence[Evaluation],
    points: Array,
    name: str,
    level: float,
) -> Found:
    """Return what a parameter does that was moved with others, in runs at some points (n, d)."""
    space = study.search_space()
    own = space.names.index(name)
    others = [space.names.index(other) for other in planned.screened if other != name]
    lower, upper = planned.values[name]
    ends = space.cube_of({**space.defaults, name: value} for value in (lower, upper))
    contrasts = np.array([[ends[1, own] - ends[0, own]]])

    def tested(values: Array, which: Array) -> LinearEffect:
        rest = np.column_stack([np.ones(len(values)), points[which][:, others]])
        return _tested(values, rest, points[which][:, [own]], contrasts, level)

    complete = np.array([evaluation.outcome.complete for evaluation in done], dtype=bool)
    each = {m: (tested(_values([_complete(done)], m), complete), upper) for m in study.responses}
    if not complete.all():
        failed = (~complete).astype(np.float64)
        each[FAILURES] = (tested(failed, np.ones_like(complete)), upper)
    return _from_tests(study, name, each, level)


def _tested(
    values: Array, others: Array, factor: Array, contrasts: Array, level: float
) -> LinearEffect:
    if not len(values) or not factor.shape[1]:
        return NOTHING_KNOWN
    return linear_effect(values, others, factor, contrasts, level)


def _from_tests(
    study: Study, name: str, each: Mapping[str, tuple[LinearEffect, Value]], level: float
) -> Found:
    """Return what a parameter does, by its tests on each response."""
    effects = {m: Effect.of(study, m, test, level) for m, (test, _) in each.items()}
    moves = tuple(
        Move(effects[m], value, test.noise) for m, (test, value) in each.items() if effects[m].seen
    )
    conclusive = all(
        np.isfinite(effects[objective.metric].visible) for objective in study.objectives
    )
    return Found(ParameterEffects(name, tuple(effects.values()), conclusive=conclusive), moves)


def _complete(done: Iterable[Evaluation]) -> list[Evaluation]:
    return [evaluation for evaluation in done if evaluation.outcome.complete]


def _values(groups: Iterable[Sequence[Evaluation]], metric: str) -> Array:
    """Return a metric in groups of runs, shape (n,)."""
    return np.array([e.outcome.metrics[metric] for done in groups for e in done])
