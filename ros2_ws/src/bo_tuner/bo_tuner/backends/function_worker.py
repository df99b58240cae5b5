"""The process in which a function is called; `FunctionProcess` is its other end.

It is first told a study and a pickled function, and answers what is wrong with these, in words.
Then it is asked for evaluations, and answers ``(outcome, problem)``: an outcome and nothing, or
nothing and what is wrong with what the function has returned.
"""

import signal
import sys
from multiprocessing.connection import Connection

from bo_tuner.backends.function import FunctionBackend
from bo_tuner.backends.passed_function import unpickled
from bo_tuner.errors import FunctionError, MetricsError
from bo_tuner.trials import Evaluation, Outcome


def serve(connection: Connection) -> None:
    """Answer until the other end is closed."""
    study, passed = connection.recv()
    try:
        backend = FunctionBackend(study, unpickled(passed))
    except FunctionError as error:
        connection.send(str(error))
        return
    connection.send("")
    while True:
        try:
            planned = connection.recv()
        except EOFError:
            return
        connection.send(_answer(backend, planned))


def _answer(backend: FunctionBackend, planned: Evaluation) -> tuple[Outcome | None, str]:
    try:
        return backend.outcome(planned), ""
    except MetricsError as error:
        return None, str(error)


if __name__ == "__main__":
    # No Ctrl-C comes here: it goes to the program alone, which ends this process.
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    serve(Connection(int(sys.argv[1])))
