"""Which context variable hurts a parameter set most, and how far each may drift.

All evaluations of the parameter set, whatever they were run for, tell of the constrained metric as
a function f of the context: its expectation over noise, a Gaussian process with the priors of stage
two. What is said of f comes from samples of the posterior along lines through the box, on which one
variable moves from its nominal value to a bound: a quantity is computed for each sample, and its
quantiles make up a credible band. The hyperparameters are the fitted ones; their uncertainty is not
in the band. Nothing is said of contexts beyond the study's bounds, for which there are no
evaluations.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from bo_tuner.models.gaussian_process import GaussianProcess
from bo_tuner.numerics.arrays import Array
from bo_tuner.numerics.seeds import Stream, generator
from bo_tuner.study.distributions import Discrete, Distribution
from bo_tuner.study.study import Study
from bo_tuner.trials import Evaluation, EvaluationState
from bo_tuner.worst_case.contexts import PRIORS, maximise_over_contexts

CREDIBLE = 0.9
"""Posterior probability of a band, the rest equally above and below."""

SAMPLES = 1000
STEPS = 31
"""Points of a line from the nominal value to a bound, ends included."""

FEWEST_EVALUATIONS = 5
MOST_EVALUATIONS = 300
"""Evaluations beyond this are left out: the cost grows with their cube."""


@dataclass(frozen=True)
class Band:
    """Median of a quantity and the ends of its credible band."""

    low: float
    median: float
    high: float


@dataclass(frozen=True)
class Drift:
    """How far a context variable may move from its nominal value to one of its bounds.

    Attributes
    ----------
    bound
        Where the study's range ends.
    limit
        Value at which the mean metric exceeds its limit; `bound` if it does not on the way there.
    breaks
        Probability that it does.
    """

    bound: float
    limit: Band
    breaks: float


@dataclass(frozen=True)
class VariableTolerance:
    """What one context variable does to the constrained metric.

    Attributes
    ----------
    name, unit, nominal
        Of the variable.
    relief
        How much the metric falls if, in the worst context, this variable alone is put back to its
        nominal value, in the metric's unit.
    down, up
        Drift with all other variables nominal.
    worst_down, worst_up
        Drift with all other variables as in the worst context.
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
    metric, unit, limit
        Of the worst-case constraint.
    evaluations
        How many evaluations this comes from.
    nominal
        The mean metric in the nominal context.
    worst, worst_context
        The mean metric in the worst context, and where that is.
    variables
        The one that hurts most, by the median of its relief, first.
    """

    metric: str
    unit: str
    limit: float
    evaluations: int
    nominal: Band
    worst: Band
    worst_context: Mapping[str, float]
    variables: tuple[VariableTolerance, ...]


def context_tolerance(study: Study, evaluations: Sequence[Evaluation]) -> ContextTolerance | None:
    """Tell which context variable hurts most, and how far each may drift.

    Parameters
    ----------
    study
        The study.
    evaluations
        Of one parameter set, of any stage; of more than `MOST_EVALUATIONS` whole ones the first.

    Returns
    -------
    ContextTolerance or None
        None without a worst-case constraint or contexts, or with too few evaluations.
    """
    constraint, space = study.worst_case_constraint, study.context_space()
    whole = [
        evaluation
        for evaluation in evaluations
        if evaluation.outcome.state is EvaluationState.COMPLETE
    ][:MOST_EVALUATIONS]
    if constraint is None or space.dimension == 0 or len(whole) < FEWEST_EVALUATIONS:
        return None
    rng = generator(study.seed, Stream.ROBUSTNESS)
    points = space.to_cube(
        [[evaluation.context[name] for name in space.names] for evaluation in whole]
    )
    values = np.array([evaluation.outcome.metrics[constraint.metric] for evaluation in whole])
    model = GaussianProcess.fit(points, values, rng=rng, priors=PRIORS)
    worst_context, _ = maximise_over_contexts(space, model.predict_mean, rng, points)
    nominal = space.nominal()
    worst = np.array([worst_context[name] for name in space.names])
    ends = model.sample(space.to_cube(np.array([nominal, worst])), SAMPLES, rng)
    variables = []
    for column, (name, distribution) in enumerate(
        zip(space.names, space.distributions, strict=True)
    ):
        lines = [
            (base, _steps(distribution, bound))
            for base in (nominal, worst)
            for bound in (distribution.lower, distribution.upper)
        ]
        contexts = np.vstack([worst, *(_line(base, column, steps) for base, steps in lines)])
        sampled = model.sample(space.to_cube(contexts), SAMPLES, rng)
        evaluations_at = np.cumsum([1, *(len(steps) for _, steps in lines)])
        at_worst, *along = np.split(sampled, evaluations_at[:-1], axis=1)
        drifts = [
            _drift(steps, path, constraint.upper, isinstance(distribution, Discrete))
            for (_, steps), path in zip(lines, along, strict=True)
        ]
        variables.append(
            VariableTolerance(
                name=name,
                unit=study.contexts[name].unit,
                nominal=distribution.nominal,
                # The lines through the worst context begin where this variable is nominal.
                relief=_band(at_worst[:, 0] - along[2][:, 0]),
                down=drifts[0],
                up=drifts[1],
                worst_down=drifts[2],
                worst_up=drifts[3],
            )
        )
    return ContextTolerance(
        metric=constraint.metric,
        unit=study.metrics[constraint.metric].unit,
        limit=constraint.upper,
        evaluations=len(whole),
        nominal=_band(ends[:, 0]),
        worst=_band(ends[:, 1]),
        worst_context=worst_context,
        variables=tuple(sorted(variables, key=lambda v: -v.relief.median)),
    )


def _steps(distribution: Distribution, bound: float) -> Array:
    """Values (k,) of a variable from the nominal one to a bound."""
    steps = distribution.clip(np.linspace(distribution.nominal, bound, STEPS))
    if isinstance(distribution, Discrete):
        between = sorted((distribution.nominal, bound))
        steps = np.array([v for v in distribution.values if between[0] <= v <= between[1]])
    return steps if bound >= distribution.nominal else np.sort(steps)[::-1]


def _line(base: Array, column: int, steps: Array) -> Array:
    """Contexts (k, e) that have one variable's steps, and the rest of another context."""
    contexts = np.tile(base, (len(steps), 1))
    contexts[:, column] = steps
    return contexts


def _drift(steps: Array, sampled: Array, limit: float, discrete: bool) -> Drift:
    """Drift along a line of values (k,) on which the metric is sampled, shape (S, k)."""
    above = sampled > limit
    broken = above.any(axis=1)
    first = np.where(broken, above.argmax(axis=1), len(steps) - 1)
    before = np.maximum(first - 1, 0)
    rows = np.arange(len(sampled))
    low, high = sampled[rows, before], sampled[rows, first]
    # A variable with few values stays at the last one that holds.
    rise = np.where(broken & (first > 0) & (not discrete), high - low, np.inf)
    crossing = steps[before] + (limit - low) / rise * (steps[first] - steps[before])
    where = np.where(broken, crossing, steps[-1])
    return Drift(bound=float(steps[-1]), limit=_band(where), breaks=float(broken.mean()))


def _band(values: Array) -> Band:
    tail = 0.5 * (1.0 - CREDIBLE)
    low, median, high = np.quantile(values, [tail, 0.5, 1.0 - tail]).tolist()
    return Band(low, median, high)
