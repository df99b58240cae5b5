"""Whether and how a guard watches over the nodes of a study."""

from dataclasses import dataclass

from bo_tuner.errors import StudyError
from bo_tuner.study import checks
from bo_tuner.study.building import build

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
    timeout : float
        Time [s] without a heartbeat of the tuner after which the guard acts; at least 0.3.
    """

    always: bool = False
    timeout: float = 0.5

    def __post_init__(self) -> None:
        """Check the fields."""
        checks.boolean(self.always, "always")
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
