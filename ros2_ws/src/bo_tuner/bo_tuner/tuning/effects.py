"""Which tuned parameters were seen to move a metric, by the trials of a run.

A node may accept a parameter, read it back, and never use it. No single run shows that. The test of
each parameter on each metric is that of `models.dependence`, over all evaluations of the trials;
whether runs fail is one more response. All tests together take a parameter that does nothing for
one that does with the probability `ERROR` at most (Bonferroni).
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Annotated, Self

import numpy as np

from bo_tuner.codec.rules import Null
from bo_tuner.models.categories import Coding
from bo_tuner.models.dependence import dependences
from bo_tuner.numerics.arrays import Array
from bo_tuner.numerics.linear_effects import NO_EFFECT, NOTHING_KNOWN, LinearEffect
from bo_tuner.numerics.seeds import Stream, generator
from bo_tuner.study.study import Study
from bo_tuner.trials import TUNING, Evaluation, Trial

ERROR = 0.05
"""Probability that any parameter is said to move a metric that it does not."""
FAILURES = "failed runs"
"""Stands for the share of runs that fail, beside the names of metrics, which have no space."""
MOST_EVALUATIONS = 200
"""Evaluations that are judged, drawn from all: the time of a fit grows with their cube."""
FAR_OUT = 3.0
"""Quartile ranges from the quartiles beyond which a value counts as one there (Tukey 1977)."""
OF_SPREAD, OF_VALUE = 0.3, 0.1
"""Shares of the range of an objective over the run, and of its median, of which an effect must have
been visible so that one which was not seen is worth a word."""


@dataclass(frozen=True)
class Effect:
    """What is known of the effect of a parameter on a metric.

    Attributes
    ----------
    metric, unit
        The metric, or `FAILURES`, and its unit.
    seen
        Whether there is one.
    change
        The largest difference between two values of the parameter, in the metric's unit.
    visible
        The smallest one that would have been seen with the probability
        `numerics.linear_effects.POWER`; 0 without noise, infinite if none would.
    """

    metric: str
    unit: str
    seen: bool
    change: float
    visible: Annotated[float, Null(np.inf)]

    @classmethod
    def of(cls, study: Study, metric: str, test: LinearEffect, level: float) -> Self:
        """Return the effect on a metric by a test of a level."""
        unit = study.metrics[metric].unit if metric in study.metrics else ""
        return cls(metric, unit, test.p_value < level, test.change, test.visible)


@dataclass(frozen=True)
class ParameterEffects:
    """What is known of the effects of a parameter.

    Attributes
    ----------
    parameter
        Its name.
    effects
        On each metric.
    conclusive
        Whether effects that matter would have been seen.
    """

    parameter: str
    effects: tuple[Effect, ...]
    conclusive: bool

    @property
    def seen(self) -> bool:
        """Whether it was seen to move a metric."""
        return any(effect.seen for effect in self.effects)

    @property
    def unseen(self) -> bool:
        """Whether it was not, although that would have been seen."""
        return self.conclusive and not self.seen


def test_level(study: Study, responses: int) -> float:
    """Return the level of a single test, where each parameter is tested on some responses."""
    return ERROR / (study.search_space().dimension * responses)


def effects_in(study: Study, trials: Sequence[Trial]) -> tuple[ParameterEffects, ...]:
    """Return the effects of each tuned parameter that the trials of a run show."""
    known = [
        evaluation
        for trial in trials
        for evaluation in trial.evaluations
        if evaluation.stage in TUNING and not evaluation.outcome.unusable
    ]
    if not known:
        return ()
    rng = generator(study.seed, Stream.EFFECTS)
    if len(known) > MOST_EVALUATIONS:
        chosen = rng.choice(len(known), MOST_EVALUATIONS, replace=False)
        known = [known[k] for k in sorted(chosen.tolist())]
    space = study.search_space()
    responses = list(_responses(study, known))
    level = test_level(study, len(responses))
    by_parameter: list[list[Effect]] = [[] for _ in space.names]
    for name, evaluations, values in responses:
        each = _tested(study, evaluations, values, level, rng)
        for effects, effect in zip(by_parameter, each, strict=True):
            effects.append(Effect.of(study, name, effect, level))
    objectives = {objective.metric for objective in study.objectives}
    least = {name: _worth(values) for name, _, values in responses if name in objectives}
    return tuple(
        ParameterEffects(
            name,
            tuple(effects),
            conclusive=all(e.visible <= least[e.metric] for e in effects if e.metric in objectives),
        )
        for name, effects in zip(space.names, by_parameter, strict=True)
    )


def _responses(
    study: Study, known: Sequence[Evaluation]
) -> Iterator[tuple[str, Sequence[Evaluation], Array]]:
    """Yield each response by its name, with its evaluations and values (n,) in them."""
    complete = [evaluation for evaluation in known if evaluation.outcome.complete]
    # A run that was cut short says nothing of a metric's mean, nor of failures.
    ended = [e for e in known if not e.outcome.was_cut_short]
    failed = np.array([float(not evaluation.outcome.complete) for evaluation in ended])
    for name in study.responses:
        values = np.array([evaluation.outcome.metrics[name] for evaluation in complete])
        yield name, complete, _without_outliers(values)
    if failed.any():
        yield FAILURES, ended, failed


def _without_outliers(values: Array) -> Array:
    """Return values (n,), those far out at the fence: one of them would hide all effects."""
    if not len(values):
        return values
    lower, upper = np.quantile(values, [0.25, 0.75])
    reach = FAR_OUT * (upper - lower)
    return np.clip(values, lower - reach, upper + reach) if reach > 0.0 else values


def _tested(
    study: Study,
    evaluations: Sequence[Evaluation],
    values: Array,
    level: float,
    rng: np.random.Generator,
) -> Sequence[LinearEffect]:
    """Test a response on each parameter."""
    space, contexts = study.search_space(), study.context_space()
    if len(values) < 2:
        return [NOTHING_KNOWN] * space.dimension
    if np.ptp(values) == 0.0:
        return [NO_EFFECT] * space.dimension
    points = np.hstack(
        [
            space.cube_of(evaluation.parameters for evaluation in evaluations),
            contexts.cube_of([evaluation.context for evaluation in evaluations]),
        ]
    )
    return dependences(points, values, Coding(space.levels), space.dimension, level, rng)


def _worth(values: Array) -> float:
    """Return the effect on an objective from which on it is worth a word."""
    if not len(values):
        return 0.0
    return max(OF_SPREAD * float(np.ptp(values)), OF_VALUE * abs(float(np.median(values))))
