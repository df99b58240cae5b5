"""Whether and how a guard watches over the nodes of a study."""

from dataclasses import dataclass

from bo_tuner.codec import checks
from bo_tuner.codec.reading import build
from bo_tuner.errors import StudyError

TIMEOUT = 0.5
"""Time [s] without a heartbeat after which a guard acts, unless heartbeats come late."""
LEAST_TIMEOUT = 0.3
"""Time [s] of three heartbeats: one may be late on a busy machine."""


@dataclass(frozen=True, kw_only=True)
class Guarding:
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
    timeout: float | None = None

    def __post_init__(self) -> None:
        """Check the fields."""
        checks.boolean(self.always, "always")
        if self.timeout is None:
            return
        timeout = checks.timeout(self.timeout, "timeout")
        if timeout < LEAST_TIMEOUT:
            raise StudyError(
                f"expected at least {LEAST_TIMEOUT:g} s, found {timeout:g}", ("timeout",)
            )
        object.__setattr__(self, "timeout", timeout)


def build_guarding(value: object) -> Guarding:
    """Return what a section of a study file says of the guard.

    Raises
    ------
    StudyError
        If it violates a rule.
    """
    if isinstance(value, bool):
        return Guarding(always=value)
    guarding: Guarding = build(Guarding, value)
    return guarding
