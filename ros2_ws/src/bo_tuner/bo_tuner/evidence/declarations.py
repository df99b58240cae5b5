"""What runs contradict of a study's declarations, and of what every result takes for granted.

The study declares scales and ranges of metrics. Every result takes it for granted that runs which
are alike do not depend on when they were made.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence

import numpy as np

from bo_tuner.metrics.collect import NO_LOGARITHM
from bo_tuner.metrics.equal_runs import uneven_rates
from bo_tuner.numerics.arrays import Array
from bo_tuner.numerics.trends import trend
from bo_tuner.numerics.two_kinds import gap
from bo_tuner.study.noiseless import noise_in
from bo_tuner.study.parts import LOG
from bo_tuner.study.ranges import outside
from bo_tuner.study.study import Study
from bo_tuner.text import counted, listed, shown
from bo_tuner.trials import Evaluation, ParameterSet

CHANCE = 0.01
"""Probability that runs which are alike are said to drift, over all metrics."""

ALIKE = 1e-9
"""Share of their size by which values differ by rounding alone."""


def contradicted(study: Study, evaluations: Sequence[Evaluation]) -> Iterator[str]:
    """Yield a sentence for each declared range, scale or noise that evaluations contradict."""
    if beyond_range := outside(study.metrics, evaluations):
        yield f"A run contradicts the study: {beyond_range}."
    if noise := noise_in(study, evaluations):
        yield f"A run contradicts the study: {noise}."
    reasons = [e.outcome.reason for e in evaluations if NO_LOGARITHM in e.outcome.reason]
    for name in study.logarithmic_metrics:
        if count := sum(reason.startswith(f"metric {name} is ") for reason in reasons):
            key = f"metrics.{name}" if study.metrics[name].scale == LOG else "objective"
            yield (
                f"{counted(count, 'run')} failed as {study.metrics[name].title} was 0 or "
                f"negative, which has no logarithm ({key}.scale: log); if such a value is sound, "
                "leave the scale out."
            )


def drifts(study: Study, runs: Mapping[str, Sequence[Evaluation]]) -> Iterator[str]:
    """Yield a sentence for each metric that changes with the order of runs which are alike.

    Parameters
    ----------
    study
        The study.
    runs
        Independent draws of context and noise in the order in which they were made, by the name of
        their parameter set.
    """
    # The values, and their distances from the median: two tests of each metric.
    level = CHANCE / max(2 * len(runs) * len(study.metrics), 1)
    for name, made in runs.items():
        complete = [e.outcome.metrics for e in made if e.outcome.complete]
        for metric in study.metrics:
            values = np.array([metrics[metric] for metrics in complete if metric in metrics])
            if change := _change(values, level):
                yield (
                    f"{study.metrics[metric].title} drifts: of {len(values)} test runs of the "
                    f"{name} parameter set, later ones are {change}. Every interval takes runs for "
                    "alike: find what changes on the machine meanwhile, and validate again."
                )


def two_kinds(study: Study, runs: Mapping[str, Sequence[Evaluation]]) -> Iterator[str]:
    """Yield a sentence for each limited metric of which runs are of two kinds.

    Parameters
    ----------
    study
        The study.
    runs
        Draws by the name of their parameter set. Those with other discrete contexts may differ by
        them, and are not compared.
    """
    space = study.context_space()
    for name, made in runs.items():
        complete = [evaluation for evaluation in made if evaluation.outcome.complete]
        combinations = space.combination_of(space.cube_of([e.context for e in complete]))
        for metric in dict.fromkeys(item.metric for item in study.constraints.values()):
            for combination in sorted(set(combinations)):
                pairs = zip(complete, combinations, strict=True)
                values = [e.outcome.metrics[metric] for e, own in pairs if own == combination]
                if (between := gap(values)) is not None:
                    yield _in_words(study, metric, name, np.array(values), between)
                    break


def uneven(evaluations: Iterable[Evaluation]) -> tuple[str, ...]:
    """Return a sentence on signals that come less often in one run of a set than in another."""
    by_set: dict[ParameterSet, list[Evaluation]] = {}
    for evaluation in evaluations:
        if evaluation.outcome.complete and evaluation.outcome.notes.rates:
            by_set.setdefault(evaluation.parameter_set, []).append(evaluation)
    found: dict[str, str] = {}
    for runs in by_set.values():
        outcomes = [e.outcome for e in runs]
        of_set = uneven_rates(
            [e.place for e in runs], [o.notes.rates for o in outcomes], [o.load for o in outcomes]
        )
        found = of_set | found
    if not found:
        return ()
    (_, text), *others = found.items()
    so = f" ({listed([name for name, _ in others])} likewise)" if others else ""
    return (f"Equal runs are not alike{so}: {text}.",)


def _in_words(study: Study, metric: str, name: str, values: Array, between: float) -> str:
    above = values > between
    limits = study.constraints.values()
    on_mean = any(item.metric == metric and not item.rule.on_runs for item in limits)
    asks = on_mean and study.metrics[metric].range is None
    return (
        f"Runs of the {name} parameter set are of two kinds: {study.metrics[metric].title} of "
        f"{counted(int(above.sum()), 'run')} is near {shown(float(np.median(values[above])))}, of "
        f"the other {int((~above).sum())} near {shown(float(np.median(values[~above])))}."
        + f" If a single context has both, the limit on the mean takes metrics.{metric}.range."
        * asks
    )


def _change(values: Array, level: float) -> str:
    """Say how values (n,) change with their order; empty if that may be chance."""
    if not len(values) or float(np.ptp(values)) <= ALIKE * float(np.abs(values).max()):
        return ""
    scatter = np.abs(values - np.median(values))
    for series, rising, falling in (
        (values, "larger", "smaller"),
        (scatter, "more scattered", "less scattered"),
    ):
        rho, p_value = trend(series)
        if p_value < level:
            change = rising if rho > 0.0 else falling
            return f"{change} (rank correlation {shown(round(rho, 2))}, p = {p_value:.1g})"
    return ""
