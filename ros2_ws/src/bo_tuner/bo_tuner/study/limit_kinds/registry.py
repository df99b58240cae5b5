"""The kinds of limits by their name in a study file."""

from collections.abc import Callable

from bo_tuner.study.limit_kinds.chance import Chance
from bo_tuner.study.limit_kinds.kind import LimitKind
from bo_tuner.study.limit_kinds.limited import Limited
from bo_tuner.study.limit_kinds.worst_mean import WorstMean
from bo_tuner.study.limit_kinds.worst_runs import WorstRuns


def worst_case(limited: Limited) -> LimitKind:
    """Return the limit in every context: on single runs if it has a probability."""
    return WorstMean(limited) if limited.probability is None else WorstRuns(limited)


KINDS: dict[str, Callable[[Limited], LimitKind]] = {"chance": Chance, "worst_case": worst_case}
"""Makes a limit of its kind, by the `kind` in a study file."""
