"""The rest of a machine ahead of a run."""

from collections.abc import Callable

from bo_tuner.backends.layers.layer import Layer, Run
from bo_tuner.trials import Evaluation, Outcome


def rested(rest: Callable[[], tuple[float, Outcome | None]]) -> Layer:
    """Let a machine rest ahead of each run.

    Parameters
    ----------
    rest
        Waits until the machine has rested; returns for how long [s], and what the evaluation is
        where it does not come to rest, or None.
    """

    def layer(run: Run) -> Run:
        def after_rest(planned: Evaluation) -> Outcome:
            seconds, fault = rest()
            return fault or run(planned).noted(rested_seconds=round(seconds, 3))

        return after_rest

    return layer
