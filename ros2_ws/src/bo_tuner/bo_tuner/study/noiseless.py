"""A simulator that the study declares free of noise, and whether its runs are.

Of such a study one run tells all of a parameter set in a context. What rests on that is only as
good as the declaration, so it is held against runs of the same parameter set in the same context
with different seeds.
"""

from collections.abc import Iterable

from bo_tuner.study.study import Study
from bo_tuner.trials import Evaluation, Value

ALIKE = 1e-9
"""Share of their size by which values differ by rounding alone."""


def noise_in(study: Study, evaluations: Iterable[Evaluation]) -> str:
    """Say in which metric two runs differ that must not; empty if none do, or may."""
    if not study.is_noiseless:
        return ""
    first: dict[tuple[frozenset[tuple[str, Value]], ...], Evaluation] = {}
    for evaluation in evaluations:
        if not evaluation.outcome.complete:
            continue
        key = frozenset(evaluation.parameters.items()), frozenset(evaluation.context.items())
        other = first.setdefault(key, evaluation)
        for name in study.responses:
            one, two = other.outcome.metrics[name], evaluation.outcome.metrics[name]
            if abs(one - two) > ALIKE * max(abs(one), abs(two)):
                return (
                    f"the study declares noise: none, but {name} was {one:.10g} and {two:.10g} in "
                    "two runs of the same parameter set in the same context (seeds "
                    f"{other.seed} and {evaluation.seed}); leave it out"
                )
    return ""
