"""A limit that in every context the mean over noise keeps (Eq. 3e)."""

from bo_tuner.study.limit_kinds.base import R, Responses
from bo_tuner.study.limit_kinds.on_mean import OnMean


class WorstMean(OnMean):
    """In every context, the worst one included, the mean over noise keeps the limit."""

    in_every_context = True

    def check(self) -> None:
        """Accept the limit: this kind needs no further field."""

    def response(self, models: Responses[R]) -> R:
        """Return the limit on the mean in every context."""
        return models.in_every_context(self.limited, 0.0)
