"""A simulator that the study declares free of noise, and whether its runs are.

Of such a study one run tells all of a parameter set in a context. What rests on that is only as
good as the declaration, so it is held against runs of the same parameter set in the same context
with different seeds.
"""

from collections.abc import Iterable
from dataclasses import dataclass

from bo_tuner.study.study import Study
from bo_tuner.trials import Evaluation, Value

ALIKE = 1e-9
"""Share of their size by which values differ by rounding alone."""


@dataclass(frozen=True)
class Noisy:
    """Two runs, with these seeds, differ in a metric though they are declared free of noise."""

    metric: str
    values: tuple[float, float]
    seeds: tuple[int, int]


def noise_in(study: Study, evaluations: Iterable[Evaluation]) -> Noisy | None:
    """Return in which metric two runs differ that must not; None if none do, or may."""
    if not study.is_noiseless:
        return None
    first: dict[tuple[frozenset[tuple[str, Value]], ...], Evaluation] = {}
    for evaluation in evaluations:
        if not evaluation.outcome.complete:
            continue
        key = frozenset(evaluation.parameters.items()), frozenset(evaluation.context.items())
        other = first.setdefault(key, evaluation)
        for name in study.responses:
            one, two = other.outcome.metrics[name], evaluation.outcome.metrics[name]
            if abs(one - two) > ALIKE * max(abs(one), abs(two)):
                return Noisy(name, (one, two), (other.seed, evaluation.seed))
    return None
