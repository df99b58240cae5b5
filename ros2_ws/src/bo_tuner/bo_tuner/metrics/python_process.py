"""Runs the functions by which a study computes metrics, in a process of their own."""

from collections.abc import Callable

from bo_tuner.asked_process import LOADING, AskedProcess, NoAnswerError
from bo_tuner.metrics.python_worker import Signals
from bo_tuner.metrics.source import MissingMetricError


class PythonProcess:
    """The process; it is started when it is first needed, and again after it has ended.

    Parameters
    ----------
    folder
        Where it works, and where modules are looked for last; empty for the present one.
    interrupted
        Called while waiting; what it raises ends the wait, and with it the process.
    """

    def __init__(self, folder: str, interrupted: Callable[[], None]) -> None:
        self._process = AskedProcess("bo_tuner.metrics.python_worker", folder, interrupted)

    def load(self, path: str) -> str:
        """Import a function, ``module:name``; returns what was wrong, empty if nothing.

        Raises
        ------
        StudyError
            If the folder is not there.
        """
        return self._ask(path, None, LOADING)[1]

    def compute(self, path: str, signals: Signals, timeout: float | None) -> float:
        """Return the value that a function computes from signals.

        Parameters
        ----------
        path
            The function.
        signals
            Its argument.
        timeout
            Longest time [s] that it may take; None for any.

        Raises
        ------
        MissingMetricError
            If that is no number, with the reason.
        """
        value, problem = self._ask(path, signals, timeout)
        if value is None:
            raise MissingMetricError(f"{path} {problem}")
        return value

    def close(self) -> None:
        """End the process at once, with all that it has started in its group."""
        self._process.close()

    def _ask(
        self, path: str, signals: Signals | None, timeout: float | None
    ) -> tuple[float | None, str]:
        try:
            answer: tuple[float | None, str] = self._process.ask((path, signals), timeout)
        except NoAnswerError as error:
            return None, str(error)
        return answer
