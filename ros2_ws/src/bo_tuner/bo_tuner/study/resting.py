"""What a machine needs that is no simulator: runs to warm up, rests, and slow changes."""

from dataclasses import dataclass
from typing import Annotated

from bo_tuner import maxima
from bo_tuner.codec.reading import Section
from bo_tuner.codec.rules import DELAY, SECONDS, Alone, Whole, Within
from bo_tuner.errors import StudyError

RAMP = Within(least=0.2, most=60.0, unit="s")
"""A shorter ramp is hardly one, and the machine is not to be under way for long."""


@dataclass(frozen=True, kw_only=True)
class WarmUp(Section):
    """Runs that count nothing, ahead of the first run of a command and after a long break.

    They have the first parameter set of `start`, in the nominal context. A number alone is that of
    the runs.

    Attributes
    ----------
    runs : int
        How many.
    after : float
        Time [s] without a run after which the machine is to be warmed up again.
    """

    runs: Annotated[int, Whole(1, maxima.WARM_UPS)]
    after: Annotated[float, SECONDS] = 600.0

    alone = Alone(int, lambda runs: {"runs": runs}, "a number of runs, or a mapping of them")


@dataclass(frozen=True, kw_only=True)
class Rest(Section):
    """The rest of the machine between two runs, with the safe parameters.

    A number alone is `at_least`.

    Attributes
    ----------
    at_least : float
        Shortest time [s] from the end of a run to the first step of the next one.
    until : str
        Condition on signals that must hold then, and ahead of the first run, such as
        `temperature < 40`.
    at_most : float
        Longest time [s] that the condition is waited for. If it does not hold by then, the
        evaluation counts as unprepared.
    """

    at_least: Annotated[float, DELAY] = 0.0
    until: str = ""
    at_most: Annotated[float, SECONDS] = 600.0

    alone = Alone(float, lambda time: {"at_least": time}, "a time [s], or a mapping of the rest")

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.at_least and not self.until:
            raise StudyError("expected at_least above 0, until, or both")
