"""What the loop asks of a backend: to run evaluations."""

import contextlib
import os
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from time import monotonic
from typing import Protocol

from bo_tuner.backends.layers.beside_default import beside_default
from bo_tuner.backends.layers.layer import Layer, stacked
from bo_tuner.backends.layers.load import measured
from bo_tuner.study.study import Study
from bo_tuner.trials import Evaluation, Outcome


class Backend(Protocol):
    """Runs evaluations of a study between `open` and `close`."""

    name: str

    def open(self) -> None:
        """Get ready to run evaluations.

        Raises
        ------
        BackendError
            If the nodes or objects cannot be had.
        """

    def run(self, evaluations: Iterable[Evaluation]) -> Iterator[Evaluation]:
        """Run planned evaluations; yields each with its outcome and duration as it ends.

        They may end in another order than they were given, and some may still run when all are
        taken and one has ended: a later call, which may bring others, yields these. A fault of a
        node or of the simulation is an outcome, not an exception.
        """

    def close(self) -> None:
        """Let go of everything that `open` took; may be called more than once."""


@contextlib.contextmanager
def opened_backend(backend: Backend) -> Iterator[Backend]:
    """Open a backend, and close it whatever happens."""
    try:
        backend.open()
        yield backend
    finally:
        backend.close()


class SequentialBackend(ABC):
    """A backend that runs one evaluation after the other.

    Parameters
    ----------
    study
        The study. If it has metrics that are relative to the default, this is run ahead of each
        evaluation.
    outside
        What a machine needs around that, from the innermost to the outermost.

    Attributes
    ----------
    after_extra_run : callable
        Called after each run that is no evaluation of its own, such as one of the default.
    """

    def __init__(self, study: Study, *outside: Layer) -> None:
        self.after_extra_run: Callable[[], object] = lambda: None
        beside = beside_default(study, lambda: self.after_extra_run())
        self._layered = stacked(self.outcome, beside, measured(lambda: self.processes), *outside)

    def run(self, evaluations: Iterable[Evaluation]) -> Iterator[Evaluation]:
        """Run planned evaluations in the order given."""
        for planned in evaluations:
            begin = monotonic()
            outcome = self._layered(planned)
            seconds = monotonic() - begin - outcome.notes.warm_up_seconds
            yield replace(planned, outcome=outcome, seconds=seconds)

    @property
    def processes(self) -> Sequence[int]:
        """Processes that perform a run, by their identifiers; those that are known."""
        return (os.getpid(),)

    @abstractmethod
    def outcome(self, planned: Evaluation) -> Outcome:
        """Set parameters, run one evaluation, and collect its metrics."""
