"""The process in which a function is called; `FunctionProcess` is its other end.

It is first told a study and a pickled function, and answers what is wrong with these, in words.
Then it is asked for evaluations, and answers ``(outcome, problem)``: an outcome and nothing, or
nothing and what is wrong with what the function has returned.
"""

import signal
import sys
from multiprocessing.connection import Connection

from bo_tuner.asked_process import serve
from bo_tuner.backends.function import FunctionBackend
from bo_tuner.backends.passed_function import unpickled
from bo_tuner.errors import FunctionError, MetricsError
from bo_tuner.study.study import Study
from bo_tuner.trials import Evaluation, Outcome


class Answers:
    """What it says to one question after the other."""

    def __init__(self) -> None:
        self._backend: FunctionBackend | None = None

    def __call__(
        self, question: tuple[Study, bytes] | Evaluation
    ) -> str | tuple[Outcome | None, str]:
        """Load the function that is asked for, or call it."""
        if isinstance(question, tuple):
            return self._loaded(*question)
        if self._backend is None:
            raise RuntimeError("no function is loaded")
        try:
            return self._backend.outcome(question), ""
        except MetricsError as error:
            return None, str(error)

    def _loaded(self, study: Study, passed: bytes) -> str:
        try:
            self._backend = FunctionBackend(study, unpickled(passed))
        except FunctionError as error:
            return str(error)
        return ""


if __name__ == "__main__":
    # No Ctrl-C comes here: it goes to the program alone, which ends this process.
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    serve(Connection(int(sys.argv[1])), Answers())
