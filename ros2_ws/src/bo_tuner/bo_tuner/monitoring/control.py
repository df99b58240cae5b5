"""Requests to pause, continue and end a run, from a service or the live page."""

from collections.abc import Iterable
from pathlib import Path

from bo_tuner.interruption import Interruption, Pause
from bo_tuner.storage.run_folder import how_to_resume


class RunControl:
    """Passes requests on to the run, from any thread, and says in words what comes of them.

    Parameters
    ----------
    pause
        Takes the requests to pause and to continue.
    interruption
        Takes the request to end the run.
    folder
        The run folder.
    """

    def __init__(self, pause: Pause, interruption: Interruption, folder: Path) -> None:
        self._pause = pause
        self._interruption = interruption
        self._folder = folder

    def going_on(self, ways: Iterable[str]) -> str:
        """Say how a run that is paused goes on: in `ways`, if there are any, or by a restart."""
        restart = f"end the run with Ctrl-C and {how_to_resume(self._folder)}"
        return ", or ".join([*(f"continue it {way}" for way in ways), restart])

    @property
    def pause_requested(self) -> bool:
        """Whether the run waits, or will after the present evaluation."""
        return self._pause.requested

    def pause(self, wait: bool) -> str:
        """Ask the run to wait, or to go on."""
        self._pause.request(wait)
        return "the run pauses after the present evaluation" if wait else "the run continues"

    def abort(self, source: str) -> str:
        """Ask for the end of the run as SIGTERM does; `source` says who asks."""
        self._interruption.request(source)
        return f"the run ends; {how_to_resume(self._folder)}"
