"""A limit that a run keeps with a probability over contexts and noise (Eq. 3d)."""

from bo_tuner.errors import StudyError
from bo_tuner.study.limit_kinds.kind import R, Responses
from bo_tuner.study.limit_kinds.on_runs import OnRuns


class Chance(OnRuns):
    """Over contexts and noise, a run keeps the limit with at least the `probability`."""

    in_every_context = False

    def check(self) -> None:
        """Refuse one without a probability."""
        if self.limited.probability is None:
            raise StudyError(
                "missing; a chance constraint needs one, such as 0.96", ("probability",)
            )

    def response(self, models: Responses[R]) -> R:
        """Return the limit on a quantile of runs over contexts and noise."""
        return models.over_contexts(self.limited, self.level)
