"""How often nodes died in runs that were made again, whatever the parameters are said to be.

A certificate then is of runs that came to an end. That says as much of all runs only if a death
depends neither on the parameter set nor on the context, which is tested.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from bo_tuner.numerics.sequential import probability_bounds
from bo_tuner.study.nodes import IGNORE
from bo_tuner.study.study import Study
from bo_tuner.trials import Evaluation

CHANCE = 0.01
"""Probability that independent deaths are said to depend on anything."""
FEWEST = 5
"""Deaths from which on they are held against contexts."""


@dataclass(frozen=True)
class Deaths:
    """Deaths in the runs of a parameter set.

    Attributes
    ----------
    deaths, runs
        Number of runs in which a node died, and of all, these included.
    bound
        Upper confidence bound of the probability that a run ends so.
    depend_on
        What deaths were seen to depend on: ``parameters``, and contexts by their name.
    """

    deaths: int
    runs: int
    bound: float
    depend_on: tuple[str, ...]


def deaths_in(
    study: Study, of_set: Sequence[Evaluation], others: Sequence[Evaluation], confidence: float
) -> Deaths | None:
    """Return how often nodes died in the runs of a parameter set; None if no death is ignored."""
    if all(spec.death != IGNORE for spec in study.nodes.values()):
        return None
    events = _events(of_set)
    bound = float(probability_bounds(events, confidence)[-1]) if len(events) else 1.0
    dependent = tuple(_dependent(study, of_set, others))
    return Deaths(int(events.sum()), len(events), bound, dependent)


def _events(evaluations: Iterable[Evaluation]) -> np.ndarray:
    """Return of all runs in their order whether a node died."""
    ended = [e.outcome.notes.deaths for e in evaluations if not e.outcome.unusable]
    return np.array([died for count in ended for died in [True] * count + [False]], dtype=bool)


def _dependent(
    study: Study, of_set: Sequence[Evaluation], others: Sequence[Evaluation]
) -> Iterator[str]:
    # It takes its time to be imported, and few studies have such nodes.
    from scipy.stats import fisher_exact, mannwhitneyu

    numbers = [name for name, item in study.contexts.items() if not item.distribution.labels]
    level = CHANCE / (1 + len(numbers))
    table = [[int(e.sum()), int((~e).sum())] for e in map(_events, (of_set, others))]
    if fisher_exact(table).pvalue < level:
        yield "parameters"
    ended = [e for e in (*of_set, *others) if not e.outcome.unusable]
    events = _events(ended)
    if events.sum() < FEWEST:
        return
    for name in numbers:
        values = [v for e in ended for v in [float(e.context[name])] * (e.outcome.notes.deaths + 1)]
        at = np.array(values)
        if mannwhitneyu(at[events], at[~events]).pvalue < level:
            yield name
