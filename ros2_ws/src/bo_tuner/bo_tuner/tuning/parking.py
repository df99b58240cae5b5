"""Parks the machine while a run waits."""

from collections.abc import Callable

from bo_tuner.tuning.observer import RunObserver


class ParkInPause(RunObserver):
    """Sets the safe parameters at the start of a pause.

    Parameters
    ----------
    park
        Sets them; returns what went wrong, each in a line.
    warn
        Is passed what went wrong.
    """

    def __init__(self, park: Callable[[], list[str]], warn: Callable[[str], None]) -> None:
        self._park = park
        self._warn = warn

    def pause(self, paused: bool) -> None:
        """Park; the next evaluation sets its own parameters."""
        if paused:
            for problem in self._park():
                self._warn(f"warning: {problem}")
