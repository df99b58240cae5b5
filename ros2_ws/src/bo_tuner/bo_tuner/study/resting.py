"""What a machine needs that is no simulator: runs to warm up, rests, and slow changes."""

from dataclasses import dataclass

from bo_tuner import maxima
from bo_tuner.codec import checks
from bo_tuner.codec.reading import build
from bo_tuner.errors import StudyError


@dataclass(frozen=True, kw_only=True)
class WarmUp:
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

    runs: int
    after: float = 600.0

    def __post_init__(self) -> None:
        """Check the fields."""
        checks.integer(self.runs, "runs", at_least=1, at_most=maxima.WARM_UPS)
        object.__setattr__(self, "after", checks.timeout(self.after, "after"))


@dataclass(frozen=True, kw_only=True)
class Rest:
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

    at_least: float = 0.0
    until: str = ""
    at_most: float = 600.0

    def __post_init__(self) -> None:
        """Check the fields."""
        at_least = checks.number(self.at_least, "at_least")
        if not 0.0 <= at_least <= maxima.TIMEOUT:
            raise StudyError(
                f"expected 0 to {maxima.TIMEOUT:g} s, found {at_least:g}", ("at_least",)
            )
        object.__setattr__(self, "at_least", at_least)
        checks.text(self.until, "until")
        object.__setattr__(self, "at_most", checks.timeout(self.at_most, "at_most"))
        if not at_least and not self.until:
            raise StudyError("expected at_least, until, or both")


SHORTEST_RAMP, LONGEST_RAMP = 0.2, 60.0
"""Times [s]: a shorter ramp is hardly one, and the machine is not to be under way for long."""


def ramp_time(value: object, *path: str | int) -> float:
    """Return a value of a study file as the time [s] of a ramp.

    Raises
    ------
    StudyError
        If it is none.
    """
    seconds = checks.number(value, *path)
    if not SHORTEST_RAMP <= seconds <= LONGEST_RAMP:
        raise StudyError(
            f"expected {SHORTEST_RAMP:g} to {LONGEST_RAMP:g} s, found {seconds:g}", path
        )
    return seconds


def build_warm_up(value: object) -> WarmUp:
    """Return the runs to warm up that a value of a study file describes.

    Raises
    ------
    StudyError
        If it violates a rule.
    """
    if not isinstance(value, dict):
        return WarmUp(runs=checks.integer(value, at_least=1, at_most=maxima.WARM_UPS))
    warm_up: WarmUp = build(WarmUp, value)
    return warm_up


def build_rest(value: object) -> Rest:
    """Return the rest between two runs that a value of a study file describes.

    Raises
    ------
    StudyError
        If it violates a rule.
    """
    if not isinstance(value, dict):
        return Rest(at_least=checks.timeout(value))
    rest: Rest = build(Rest, value)
    return rest
