"""A limit that in every context a run keeps with a probability."""

from scipy.special import ndtri

from bo_tuner.errors import StudyError
from bo_tuner.study.limit_kinds.base import R, Responses
from bo_tuner.study.limit_kinds.on_runs import OnRuns


class WorstRuns(OnRuns):
    """In every context, the worst one included, a run keeps it with at least the `probability`."""

    in_every_context = True

    def check(self) -> None:
        """Refuse a probability below one half: its quantile is on the other side of the mean."""
        if self.level < 0.5:
            raise StudyError(
                f"expected at least 0.5 of a worst_case constraint, found {self.level:g}",
                ("probability",),
            )

    def response(self, models: Responses[R]) -> R:
        """Return the limit on a quantile of runs in every context."""
        return models.in_every_context(self.limited, float(ndtri(self.level)))
