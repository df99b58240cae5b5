"""A function that is called in other processes: one after the other, or several at once."""

import inspect
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import cast

from bo_tuner import maxima
from bo_tuner.asked_process import LOADING, AskedProcess, NoAnswerError
from bo_tuner.backends.function import Function, FunctionBackend, failed
from bo_tuner.backends.protocol import Backend, SequentialBackend
from bo_tuner.backends.workers.pool import BREAKING_OFF, WorkerPool
from bo_tuner.codec import checks
from bo_tuner.codec.rules import SECONDS
from bo_tuner.errors import BackendError, FunctionError, MetricsError, MissingPackageError
from bo_tuner.processor_load import with_children
from bo_tuner.study.function_study import FUNCTION, returned_metrics
from bo_tuner.study.named_code import described
from bo_tuner.study.study import Study
from bo_tuner.trials import Evaluation, Outcome

WORKER = "bo_tuner.backends.function_worker"


def workers_of(study: Study, workers: int | None) -> int:
    """Return how many runs there are at once: as many as given, or as the study has."""
    if workers is None:
        return study.budget.workers or 1
    return checks.integer(workers, "workers", at_least=1, at_most=maxima.WORKERS)


def backend_of(study: Study, function: Function, workers: int, timeout: float | None) -> Backend:
    """Make the backend that calls a function, not open yet."""
    if timeout is not None:
        SECONDS(timeout, "timeout")
    _check_arguments(function)
    if workers == 1 and timeout is None:
        return FunctionBackend(study, function)
    returned_metrics(study)
    passed = _pickled(function)
    if workers == 1:
        return FunctionProcess(study, passed, timeout)
    _check_script()
    make = partial(_of_worker, study, passed, timeout)
    return WorkerPool(FUNCTION, workers, make, patience=BREAKING_OFF)


def _check_arguments(function: object) -> None:
    """Refuse what each run would fail for, as if it were its parameters' fault."""
    expected = "expected a function of parameters, context and seed"
    if not callable(function):
        raise FunctionError(f"{expected}, found {checks.show(function)}")
    try:
        signature = inspect.signature(function)
    except (TypeError, ValueError):
        # One that is not written in Python need not have one.
        return
    try:
        signature.bind({}, {}, 0)
    except TypeError as error:
        raise FunctionError(f"{expected}, found one of {signature}: {error}") from None


def _check_script() -> None:
    """Refuse a script that runs as a whole when it is imported, as a new process does."""
    path = getattr(sys.modules["__main__"], "__file__", None)
    try:
        text = "" if path is None else Path(path).read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError):
        return
    if text and "__main__" not in text:
        raise BackendError(
            f"each worker imports {path}, and would run all of it again; put the call below "
            'if __name__ == "__main__":'
        )


def _pickled(function: Function) -> bytes:
    """Return a function as bytes; one that no module has, as of a notebook, with its code."""
    try:
        import cloudpickle
    except ImportError as error:
        raise MissingPackageError(
            "workers and a timeout need the packages of the extra: "
            f"pip install 'bo_tuner[workers]' ({error.name} is missing)"
        ) from None
    try:
        return cast(bytes, cloudpickle.dumps(function))
    # Whatever the objects raise that belong to the function.
    except Exception as error:
        raise FunctionError(
            f"the function cannot be passed to another process, as workers and a timeout need it: "
            f"{described(error)}"
        ) from None


def unpickled(passed: bytes) -> Function:
    """Return the function in the process to which it was passed."""
    import cloudpickle

    try:
        return cast(Function, cloudpickle.loads(passed))
    except Exception as error:
        raise FunctionError(
            f"the function cannot be loaded in another process: {described(error)}"
        ) from None


def _of_worker(
    study: Study,
    passed: bytes,
    timeout: float | None,
    _number: int,
    _folder: Path,
    interrupted: Callable[[], None],
) -> Backend:
    """Make the backend of a worker."""
    if timeout is None:
        return FunctionBackend(study, unpickled(passed))
    return FunctionProcess(study, passed, timeout, interrupted)


class FunctionProcess(SequentialBackend):
    """Calls a function in a process of its own, which ends with a run that takes too long."""

    name = FUNCTION

    def __init__(
        self,
        study: Study,
        passed: bytes,
        timeout: float | None,
        interrupted: Callable[[], None] = lambda: None,
    ) -> None:
        super().__init__(study)
        self._study = study
        self._passed = passed
        self._timeout = timeout
        self._loading = LOADING if timeout is None else max(LOADING, timeout)
        self._process = AskedProcess(WORKER, interrupted=interrupted)

    def open(self) -> None:
        """Start the process, and load the function there."""
        try:
            problem = self._process.ask((self._study, self._passed), self._loading)
        except NoAnswerError as error:
            problem = f"the function cannot be loaded in another process: it {error}"
        if problem:
            self.close()
            raise FunctionError(problem)

    def close(self) -> None:
        """End the process."""
        self._process.close()

    @property
    def processes(self) -> list[int]:
        """The process in which the function is called, and what it has started."""
        return [] if (pid := self._process.pid) is None else list(with_children([pid]))

    def outcome(self, planned: Evaluation) -> Outcome:
        """Call the function; a run that takes too long or ends the process has failed."""
        if not self._process.running:
            self.open()
        try:
            outcome, problem = self._process.ask(planned, self._timeout)
        except NoAnswerError as error:
            return failed(str(error))
        if problem:
            raise MetricsError(problem)
        return cast(Outcome, outcome)
