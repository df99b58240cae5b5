"""Whether and how a guard watches over the nodes of a study."""

from dataclasses import dataclass
from typing import Annotated

from bo_tuner import maxima
from bo_tuner.codec.reading import Section
from bo_tuner.codec.rules import Alone, Within

TIMEOUT = 0.5
"""Time [s] without a heartbeat after which a guard acts, unless heartbeats come late."""
LEAST_TIMEOUT = 0.3
"""Time [s] of three heartbeats: one may be late on a busy machine."""


@dataclass(frozen=True, kw_only=True)
class Guarding(Section):
    """A guard leaves the nodes safe if the tuner dies, hangs or misses the abort condition.

    ``guard: true`` alone says as much as ``guard: {always: true}``.

    Attributes
    ----------
    always : bool
        Also over nodes that the tuner starts; nodes that it attaches to are guarded anyway.
    timeout : float, optional
        Time [s] without a heartbeat of the tuner after which the guard acts; at least 0.3. Without
        it that is 0.5 s, and up to 1.5 s while the computer is so busy that heartbeats come late.
    """

    always: bool = False
    timeout: Annotated[float, Within(least=LEAST_TIMEOUT, most=maxima.TIMEOUT, unit="s")] | None = (
        None
    )

    alone = Alone(bool, lambda always: {"always": always}, "true, false, or a mapping of the guard")
