"""How long it took until nodes had the values of a run: by small steps, or by starting anew."""

from collections.abc import Callable, Sequence

from bo_tuner.backends.layers.layer import Layer, Run
from bo_tuner.trials import Evaluation, Outcome


def ramped(take_seconds: Callable[[], float]) -> Layer:
    """Note how long [s] parameters were under way; `take_seconds` tells it since the last call."""

    def layer(run: Run) -> Run:
        def timed(planned: Evaluation) -> Outcome:
            take_seconds()
            return run(planned).noted(ramped_seconds=round(take_seconds(), 3))

        return timed

    return layer


def with_starts(take_starts: Callable[[], Sequence[float]]) -> Layer:
    """Note how long [s] each start of a node took that came since the last call."""

    def layer(run: Run) -> Run:
        def counted(planned: Evaluation) -> Outcome:
            outcome = run(planned)
            starts = take_starts()
            return outcome.with_starts(len(starts), sum(starts))

        return counted

    return layer
