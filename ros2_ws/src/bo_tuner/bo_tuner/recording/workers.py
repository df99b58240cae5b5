"""What the nodes of workers say: heard in the process of each, and written by that of the run.

A worker hands on what it has heard of an evaluation with the result. So all bags are written in one
place, within one limit of size, also those of workers on other hosts.
"""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Generic, Protocol, Self, TypeVar

from bo_tuner.backends.protocol import Backend
from bo_tuner.backends.workers.answer import Answer
from bo_tuner.metrics.recording import NOTHING_RECORDED, Recording
from bo_tuner.recording.inbox import Batch, Inbox
from bo_tuner.recording.recorder import LATEST_QUIET, MEMORY, QUIET, Recorder
from bo_tuner.recording.run_recording import Listener
from bo_tuner.trials import Evaluation


@dataclass(frozen=True)
class HeardRun:
    """What a worker has heard of an evaluation.

    Attributes
    ----------
    batch
        The messages.
    signals
        The signals of the run.
    warnings
        What has gone wrong so far, each in a line.
    """

    batch: Batch
    signals: Recording
    warnings: tuple[str, ...] = ()


class OnNodes(Backend, Protocol):
    """A backend whose nodes can be heard."""

    after_extra_run: Callable[[], object]

    @property
    def recording(self) -> Recording:
        """The signals of the last run."""

    def park(self) -> list[str]:
        """Set the safe parameters; returns what went wrong."""


OnNodesT = TypeVar("OnNodesT", bound=OnNodes)


class ListeningBackend(Generic[OnNodesT]):
    """The backend of a worker, with what its nodes say in each evaluation.

    Attributes
    ----------
    heard
        What was heard of the last evaluation.
    """

    def __init__(self, listen: Callable[[OnNodesT, Inbox], Listener], backend: OnNodesT) -> None:
        self.name = backend.name
        self.park = backend.park
        self.heard: HeardRun | None = None
        self._listen = listen
        self._backend = backend
        self._inbox = Inbox(QUIET, LATEST_QUIET, MEMORY)
        self._listener: Listener | None = None

    def open(self) -> None:
        """Get ready, and begin to listen."""
        self._backend.open()
        listener = self._listener = self._listen(self._backend, self._inbox)
        # One of the default beside an evaluation is none of its own.
        self._backend.after_extra_run = lambda: self._inbox.collect(listener.take)

    def run(self, evaluations: Iterable[Evaluation]) -> Iterator[Evaluation]:
        """Run evaluations one after the other; what came before one belongs to none."""
        for planned in evaluations:
            self._take()
            self._inbox.forget()
            (evaluation,) = self._backend.run([planned])
            batch = self._inbox.collect(self._take)
            warnings = tuple(self._inbox.warnings)
            self.heard = HeardRun(batch, self._backend.recording, warnings)
            yield evaluation
            # Nodes may have been started anew, and have other topics.
            if self._listener is not None:
                self._listener.refresh()

    def _take(self) -> None:
        if self._listener is not None:
            self._listener.take()

    def close(self) -> None:
        """Stop listening, and close the backend."""
        listener, self._listener = self._listener, None
        try:
            if listener is not None:
                listener.close()
        finally:
            self._backend.close()


class HeardByWorkers:
    """A listener of the run, to which workers are what nodes are to one in their process.

    Attributes
    ----------
    signals
        Of that evaluation.
    worker
        That has run it.
    """

    def __init__(self, latest: Callable[[], Answer | None]) -> None:
        self._latest = latest
        self._recorder: Recorder | None = None
        self.signals = NOTHING_RECORDED
        self.worker = ""

    def to(self, recorder: Recorder) -> Self:
        """Hand on messages to a recorder."""
        self._recorder = recorder
        return self

    def refresh(self) -> bool:
        """Return that there are no other topics: workers look for themselves."""
        return False

    def take(self) -> None:
        """Hand on what a worker has heard."""
        answer = self._latest()
        heard = None if answer is None else answer.heard
        if answer is None or self._recorder is None or not isinstance(heard, HeardRun):
            # Such as one that was lost with its worker.
            self.signals = NOTHING_RECORDED
            return
        self.signals, self.worker = heard.signals, answer.worker
        self._recorder.add(heard.batch)
        for text in heard.warnings:
            self._recorder.warn(text)

    def close(self) -> None:
        """Do nothing: workers stop listening when they are closed."""
