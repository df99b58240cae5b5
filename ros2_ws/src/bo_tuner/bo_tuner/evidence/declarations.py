"""What runs contradict of a study's declarations, and of what every result takes for granted.

The study declares scales and ranges of metrics. Every result takes it for granted that runs which
are alike do not depend on when they were made.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence

import numpy as np

from bo_tuner.evidence.differences import ALIKE
from bo_tuner.evidence.facts import Contradicted, Drift, Fact, NoLogarithm, TwoKinds, UnevenRates
from bo_tuner.metrics.collect import NO_LOGARITHM
from bo_tuner.metrics.equal_runs import UnevenRate, uneven_rates
from bo_tuner.numerics.arrays import Array
from bo_tuner.numerics.trends import trend
from bo_tuner.numerics.two_kinds import gap
from bo_tuner.study.noiseless import noise_in
from bo_tuner.study.parts import LOG
from bo_tuner.study.ranges import outside
from bo_tuner.study.study import Study
from bo_tuner.trials import Evaluation, ParameterSet

CHANCE = 0.01
"""Probability that runs which are alike are said to drift, over all metrics."""


def contradicted(study: Study, evaluations: Sequence[Evaluation]) -> Iterator[Fact]:
    """Yield a fact for each declared range, scale or noise that evaluations contradict."""
    for how in (outside(study.metrics, evaluations), noise_in(study, evaluations)):
        if how is not None:
            yield Contradicted(how)
    reasons = [e.outcome.reason for e in evaluations if NO_LOGARITHM in e.outcome.reason]
    for name in study.logarithmic_metrics:
        if count := sum(reason.startswith(f"metric {name} is ") for reason in reasons):
            key = f"metrics.{name}" if study.metrics[name].scale == LOG else "objective"
            yield NoLogarithm(study.metrics[name].title, key, count)


def drifts(study: Study, runs: Mapping[str, Sequence[Evaluation]]) -> Iterator[Drift]:
    """Yield each metric that changes with the order of runs which are alike."""
    # The values, and their distances from the median: two tests of each metric.
    level = CHANCE / max(2 * len(runs) * len(study.metrics), 1)
    for name, made in runs.items():
        complete = [e.outcome.metrics for e in made if e.outcome.complete]
        for metric in study.metrics:
            values = np.array([metrics[metric] for metrics in complete if metric in metrics])
            if (change := _change(values, level)) is not None:
                yield Drift(study.metrics[metric].title, name, len(values), *change)


def two_kinds(study: Study, runs: Mapping[str, Sequence[Evaluation]]) -> Iterator[TwoKinds]:
    """Yield each limited metric of which runs are of two kinds."""
    space = study.context_space()
    for name, made in runs.items():
        complete = [evaluation for evaluation in made if evaluation.outcome.complete]
        combinations = space.combination_of(space.cube_of([e.context for e in complete]))
        for metric in dict.fromkeys(item.metric for item in study.constraints.values()):
            for combination in sorted(set(combinations)):
                pairs = zip(complete, combinations, strict=True)
                values = [e.outcome.metrics[metric] for e, own in pairs if own == combination]
                if (between := gap(values)) is not None:
                    yield _two_kinds(study, metric, name, np.array(values), between)
                    break


def uneven(study: Study, evaluations: Iterable[Evaluation]) -> Iterator[UnevenRates]:
    """Yield a fact on signals that come less often in one run of a set than another.

    A bag has its own gaps: only runs that play the same one are equal.
    """
    by_set: dict[tuple[ParameterSet, str], list[Evaluation]] = {}
    for evaluation in evaluations:
        if evaluation.outcome.complete and evaluation.outcome.notes.rates:
            key = evaluation.parameter_set, study.bag_in(evaluation.context)
            by_set.setdefault(key, []).append(evaluation)
    found: dict[str, UnevenRate] = {}
    for runs in by_set.values():
        outcomes = [e.outcome for e in runs]
        of_set = uneven_rates(
            [e.place for e in runs], [o.notes.rates for o in outcomes], [o.load for o in outcomes]
        )
        found = of_set | found
    if found:
        first, *others = found.values()
        yield UnevenRates(first, tuple(other.signal for other in others))


def _two_kinds(study: Study, metric: str, name: str, values: Array, between: float) -> TwoKinds:
    above = values > between
    limits = study.constraints.values()
    on_mean = any(item.metric == metric and not item.rule.on_runs for item in limits)
    high, low = values[above], values[~above]
    return TwoKinds(
        metric,
        study.metrics[metric].title,
        name,
        above=(len(high), float(np.median(high))),
        below=(len(low), float(np.median(low))),
        needs_range=on_mean and study.metrics[metric].range is None,
    )


def _change(values: Array, level: float) -> tuple[bool, float, float] | None:
    """Return whether the scatter of values (n,) changes with their order, and how surely.

    The rank correlation and its p-value; None if a change may be chance.
    """
    if not len(values) or float(np.ptp(values)) <= ALIKE * float(np.abs(values).max()):
        return None
    scatter = np.abs(values - np.median(values))
    for in_scatter, series in ((False, values), (True, scatter)):
        rho, p_value = trend(series)
        if p_value < level:
            return in_scatter, rho, p_value
    return None
