"""Which context variable a parameter set is most sensitive to, and how far each may drift.

The constrained metric, in expectation over noise, is a function f of the context, of which
`bo_tuner.evidence.certificate.context_response` draws samples from the posterior, given all
evaluations of the parameter set. Every quantity is computed for these samples along lines through
the box, on which one variable moves from its nominal value to a bound; its quantiles over the
samples are a credible band. There are no evaluations outside the study's bounds, and no predictions
either.

The worst mean is the largest value of f, wherever that is: the context with the largest posterior
mean need not be the worst one. So its band ends above at the quantile of the largest value of a
sample, and below at that of the value in the stated context, which the largest cannot be less than.

A limit on a share of single runs is broken where their quantile is beyond it, not only their mean.
So for a drift f is held against the limit less that quantile of the residuals of all evaluations,
which takes noise for alike in all contexts.

How often the bands hold the truth is measured by `benchmarks/band_coverage.py`.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from bo_tuner.evidence.certificate.context_response import KEPT, ContextResponse
from bo_tuner.models.context_maximum import maximize_over_contexts
from bo_tuner.numerics.arrays import Array
from bo_tuner.numerics.latin_hypercube import latin_hypercube
from bo_tuner.numerics.seeds import Stream, generator
from bo_tuner.study.constraint import Constraint
from bo_tuner.study.context_space import ContextSpace
from bo_tuner.study.distributions import Discrete, Distribution
from bo_tuner.study.limit_kinds.limited import UPPER
from bo_tuner.study.study import Study
from bo_tuner.text import shown
from bo_tuner.trials import Context, Evaluation, Value

CREDIBLE = 0.9
"""Posterior probability of a credible band, with equal tails."""

SAMPLES = 1000 // KEPT
"""Samples from each process of the mixture."""

STEPS = 31
"""Points on a line from the nominal value to a bound, including both."""

FEWEST_EVALUATIONS = 5
MOST_CONTEXTS = 150
"""Further contexts are left out: the cost of a fit grows with the cube of their number."""

INSIDE, NEAR = 200, 50
"""Contexts within the box, and around the worst one, among which a sample is the largest."""

STRETCH = 1.3
"""Factor by which the contexts within the box are moved away from its middle, up to its faces."""

AROUND = 0.1
"""Standard deviation of the contexts around the worst one, in edges of the unit cube."""


@dataclass(frozen=True)
class Band:
    """Median and credible band of a quantity."""

    low: float
    median: float
    high: float


@dataclass(frozen=True)
class Drift:
    """How far a context variable may move from its nominal value to one of its bounds.

    Attributes
    ----------
    bound
        The bound in the study.
    limit
        Value at which the metric breaks its limit, by its mean over noise or by the quantile of
        runs that the limit is on; `bound` if it does not.
    breaks
        Probability that it crosses the limit before the bound.
    """

    bound: float
    limit: Band
    breaks: float

    @property
    def in_words(self) -> str:
        """The last tolerated value, with its band if the limit is crossed before the bound."""
        if self.breaks <= 0.5 * (1.0 - CREDIBLE):
            return f"{shown(self.bound)} *"
        limit = self.limit
        return f"{shown(limit.median)} ({shown(limit.low)} to {shown(limit.high)})"


@dataclass(frozen=True)
class VariableTolerance:
    """Effect of one context variable on the constrained metric.

    Attributes
    ----------
    name, unit, nominal
        Name, unit and nominal value of the variable.
    relief
        By how much the metric moves away from the limit when, in the worst context, this variable
        alone returns to its nominal value, in the metric's unit.
    down, up
        Drift with all other variables nominal.
    worst_down, worst_up
        Drift with all other variables at their values in the worst context.
    """

    name: str
    unit: str
    nominal: float
    relief: Band
    down: Drift
    up: Drift
    worst_down: Drift
    worst_up: Drift


@dataclass(frozen=True)
class ContextTolerance:
    """How the constrained metric of a parameter set depends on the context.

    Attributes
    ----------
    constraint, metric, unit, limit, side
        Of the worst-case constraint.
    evaluations
        Number of evaluations behind the model.
    nominal
        The mean metric in the nominal context.
    worst, worst_context
        The worst mean metric over all contexts, and the context with the worst posterior mean.
    variables
        In decreasing order of the median relief.
    """

    constraint: str
    metric: str
    unit: str
    limit: float
    side: str
    evaluations: int
    nominal: Band
    worst: Band
    worst_context: Context
    variables: tuple[VariableTolerance, ...]

    @property
    def relieved(self) -> str:
        """Where the metric moves when it moves away from the limit: ``lower`` or ``higher``."""
        return "lower" if self.side == UPPER else "higher"


def context_tolerances(
    study: Study, evaluations: Sequence[Evaluation]
) -> tuple[ContextTolerance, ...]:
    """Rank the context variables by their effect, and return how far each may drift."""
    complete = _first_contexts(e for e in evaluations if e.outcome.complete)
    if not study.context_space().ordered or len(complete) < FEWEST_EVALUATIONS:
        return ()
    return tuple(_tolerance(study, item, complete) for item in study.worst_case_constraints)


def _first_contexts(evaluations: Iterable[Evaluation]) -> list[Evaluation]:
    """Return the evaluations in the first `MOST_CONTEXTS` different contexts."""
    chosen: set[tuple[Value, ...]] = set()
    kept = []
    for evaluation in evaluations:
        context = tuple(evaluation.context.values())
        if context in chosen or len(chosen) < MOST_CONTEXTS:
            chosen.add(context)
            kept.append(evaluation)
    return kept


def _tolerance(
    study: Study, constraint: Constraint, complete: Sequence[Evaluation]
) -> ContextTolerance:
    """Return the tolerance of one constraint. The metric is modelled times the side's sign."""
    space, sign = study.context_space(), constraint.sign
    rng = generator(study.seed, Stream.ROBUSTNESS)
    points = space.cube_of([evaluation.context for evaluation in complete])
    values = sign * np.array(
        [evaluation.outcome.metrics[constraint.metric] for evaluation in complete]
    )
    model = ContextResponse(points, values, rng)
    limit = sign * constraint.limit
    if constraint.rule.on_runs:
        limit -= float(np.quantile(values - model.mean(points), constraint.level))
    worst_context, _ = maximize_over_contexts(space, model.mean, rng, points)
    nominal = space.nominal()
    worst = space.rows([worst_context])[0]
    considered = _considered(space, worst, points, rng)
    sampled = model.sample(np.vstack([space.to_cube([nominal]), considered]), SAMPLES, rng)
    at_nominal, at_worst = _band(sign * sampled[:, 0]), _band(sampled[:, 1])
    highest = Band(at_worst.low, at_worst.median, _band(sampled[:, 1:].max(axis=1)).high)
    variables = []
    for column, (name, distribution) in enumerate(
        zip(space.names, space.distributions, strict=True)
    ):
        if name not in space.ordered:
            # Nothing drifts from one truth value or text to another.
            continue
        lines = [
            (base, _steps(distribution, float(nominal[column]), bound))
            for base in (nominal, worst)
            for bound in (distribution.lower, distribution.upper)
        ]
        contexts = np.vstack([worst, *(_line(base, column, steps) for base, steps in lines)])
        sampled = model.sample(space.to_cube(contexts), SAMPLES, rng)
        evaluations_at = np.cumsum([1, *(len(steps) for _, steps in lines)])
        there, *along = np.split(sampled, evaluations_at[:-1], axis=1)
        drifts = [
            _drift(steps, path, limit, isinstance(distribution, Discrete))
            for (_, steps), path in zip(lines, along, strict=True)
        ]
        variables.append(
            VariableTolerance(
                name=name,
                unit=study.contexts[name].unit,
                nominal=float(nominal[column]),
                # Lines through the worst context start at the nominal value of this variable.
                relief=_band(there[:, 0] - along[2][:, 0]),
                down=drifts[0],
                up=drifts[1],
                worst_down=drifts[2],
                worst_up=drifts[3],
            )
        )
    return ContextTolerance(
        constraint=constraint.name,
        metric=constraint.metric,
        unit=study.metrics[constraint.metric].unit,
        limit=constraint.limit,
        side=constraint.side,
        evaluations=len(complete),
        nominal=at_nominal,
        worst=highest if sign > 0.0 else Band(-highest.high, -highest.median, -highest.low),
        worst_context=worst_context,
        variables=tuple(sorted(variables, key=lambda v: -v.relief.median)),
    )


def _considered(
    space: ContextSpace, worst: Array, points: Array, rng: np.random.Generator
) -> Array:
    """Return contexts (k, e) of the cube among which a sample is the largest, `worst` (e,) first.

    Besides it those of the data, the corners, some on and within the faces, and some near it.
    """
    first = space.to_cube([worst])
    inside = (latin_hypercube(INSIDE, space.dimension, rng) - 0.5) * STRETCH + 0.5
    near = first + AROUND * rng.standard_normal((NEAR, space.dimension))
    others = np.vstack([points, space.corners(), inside, near])
    others = np.unique(space.to_cube(space.to_contexts(others)), axis=0)
    return np.vstack([first, others])


def _steps(distribution: Distribution, nominal: float, bound: float) -> Array:
    """Values (k,) of a variable from its nominal value to a bound."""
    steps = distribution.clip(np.linspace(nominal, bound, STEPS))
    if isinstance(distribution, Discrete):
        low, high = sorted((nominal, bound))
        steps = distribution.support
        steps = steps[(low <= steps) & (steps <= high)]
    return steps if bound >= nominal else np.sort(steps)[::-1]


def _line(base: Array, column: int, steps: Array) -> Array:
    """Contexts (k, e): the context `base` with one variable replaced by each of `steps` (k,)."""
    contexts = np.tile(base, (len(steps), 1))
    contexts[:, column] = steps
    return contexts


def _drift(steps: Array, sampled: Array, limit: float, discrete: bool) -> Drift:
    """Drift along values `steps` (k,) at which the metric is sampled, shape (S, k)."""
    above = sampled > limit
    broken = above.any(axis=1)
    first = np.where(broken, above.argmax(axis=1), len(steps) - 1)
    before = np.maximum(first - 1, 0)
    rows = np.arange(len(sampled))
    low, high = sampled[rows, before], sampled[rows, first]
    # A discrete variable may drift to the last value that keeps the limit.
    rise = np.where(broken & (first > 0) & (not discrete), high - low, np.inf)
    crossing = steps[before] + (limit - low) / rise * (steps[first] - steps[before])
    where = np.where(broken, crossing, steps[-1])
    return Drift(bound=float(steps[-1]), limit=_band(where), breaks=float(broken.mean()))


def _band(values: Array) -> Band:
    tail = 0.5 * (1.0 - CREDIBLE)
    low, median, high = np.quantile(values, [tail, 0.5, 1.0 - tail]).tolist()
    return Band(low, median, high)
