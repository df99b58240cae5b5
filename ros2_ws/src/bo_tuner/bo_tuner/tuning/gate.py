"""Where a run waits on request, or ends: between two evaluations."""

from collections.abc import Callable

from bo_tuner.interruption import Pause
from bo_tuner.tuning.observer import NOBODY, RunObserver


class Gate:
    """Pauses the run between two evaluations on request, and ends it on a signal.

    It is passed when all observers know of the evaluation: the record and the displays are complete
    before a pause.

    Parameters
    ----------
    check
        Raises if the run is to end; also called all the while in a pause.
    observer
        Is told of the start and the end of a pause.

    Attributes
    ----------
    requests
        Takes the requests to pause and to continue.
    """

    def __init__(
        self, check: Callable[[], None] = lambda: None, observer: RunObserver = NOBODY
    ) -> None:
        self._check = check
        self._observer = observer
        self.requests = Pause()

    def wait(self) -> None:
        """Wait while a pause is requested; raise if the run is to end."""
        self._check()
        if not self.requests.requested:
            return
        self._observer.pause(True)
        self.requests.wait(self._look)
        self._observer.pause(False)

    def _look(self) -> None:
        self._check()
        self._observer.waiting()


OPEN = Gate()
"""Never closed: nobody has its requests."""
