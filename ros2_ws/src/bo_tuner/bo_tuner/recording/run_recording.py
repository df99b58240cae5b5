"""The recording of a run, from its first trial to the validation, or none at all."""

import contextlib
from collections.abc import Callable
from pathlib import Path
from typing import Protocol, Self

from bo_tuner.metrics.recording import NOTHING_RECORDED, Recording
from bo_tuner.optimizers.ranking import Candidate
from bo_tuner.plans import Phase
from bo_tuner.recording.recorder import Recorder
from bo_tuner.recording.retention import Policy, RecordOptions
from bo_tuner.storage.run_files import BAGS, LOGS
from bo_tuner.study.study import Study
from bo_tuner.trials import Evaluation, Trial
from bo_tuner.tuning.observer import RunObserver

LOG = "recording.log"


class Listener(Protocol):
    """Hands on what the nodes say, until it is closed."""

    def refresh(self) -> bool:
        """Hear topics that were not there before, too; returns whether there were any."""

    def take(self) -> None:
        """Hand on what has come by now."""

    def close(self) -> None:
        """Stop listening."""


Listen = Callable[[Recorder], Listener]
"""Makes a listener that hands messages to a recorder."""


class RunRecording(RunObserver):
    """Records evaluations; use it in a ``with`` block around them."""

    def __init__(
        self,
        folder: Path,
        study: Study,
        options: RecordOptions,
        listen: Listen | None,
        report: Callable[[str], None],
        signals: Callable[[], Recording] = lambda: NOTHING_RECORDED,
        worker: Callable[[], str] = lambda: "",
        at_once: int = 1,
    ) -> None:
        self._folder = folder
        self._study = study
        self._options = options
        self._listen = listen
        self._report = report
        self._signals = signals
        self._worker = worker
        self._at_once = at_once
        self._recorder: Recorder | None = None
        self._listener: Listener | None = None
        self.summary: dict[str, object] = {"policy": str(Policy.NONE)}

    def __enter__(self) -> Self:
        """Start to listen."""
        if self._listen is not None and self._options.policy is not Policy.NONE:
            self._recorder = Recorder(
                self._folder / BAGS, self._study, self._options, at_once=self._at_once
            )
            try:
                self._listener = self._listen(self._recorder)
            except BaseException:
                self._recorder.close()
                raise
        return self

    def __exit__(self, *_: object) -> None:
        """Stop listening and finish the bags."""
        if self._listener is not None:
            self._listener.close()
            self._listener = None
        if self._recorder is not None:
            self.summary = self._recorder.close()
            self._pass_news_on()
            self._recorder = None

    def evaluation(self, evaluation: Evaluation) -> None:
        """Record the messages of an evaluation; one that was on record has none."""
        if evaluation.recorded:
            return
        if self._recorder is not None and self._listener is not None:
            self._listener.take()
            self._recorder.evaluation(evaluation, self._signals(), self._worker())

    def trial(self, trial: Trial, incumbent: Candidate | None) -> None:
        """Finish the bag of a trial."""
        best = incumbent is not None and incumbent.trial.number == trial.number
        if self._recorder is not None and self._listener is not None:
            self._recorder.wait_for_quiet(self._listener.take)
            self._recorder.trial(trial, best)
            self._listener.refresh()
            self._pass_news_on()

    def planned(self, phase: str) -> None:
        """Let go of what came while a trial was proposed.

        Only then: in other phases the last messages of an evaluation may still be on their way.
        """
        if phase == Phase.TUNING:
            self._forget()

    def pause(self, paused: bool) -> None:
        """Let go of what came in a pause."""
        if not paused:
            self._forget()

    def _forget(self) -> None:
        """Let go of what belongs to no evaluation: it would take the memory of the next one."""
        if self._recorder is not None and self._listener is not None:
            self._listener.take()
            self._recorder.forget()

    def skip(self) -> None:
        """Let go of a run that is no evaluation, such as one of the default beside it."""
        if self._recorder is not None and self._listener is not None:
            # Its last messages are still on their way.
            self._recorder.wait_for_quiet(self._listener.take)
            self._forget()

    def end(self, phase: str) -> None:
        """Finish the bag of the checks or of the validation."""
        if phase == Phase.TUNING:
            return
        if self._recorder is not None and self._listener is not None:
            self._recorder.wait_for_quiet(self._listener.take)
            self._recorder.phase_ended()
            self._pass_news_on()

    def _pass_news_on(self) -> None:
        news = self._recorder.news() if self._recorder is not None else []
        for text in news:
            self._report(text)
            # On a full disk there is no log either; the run goes on.
            with (
                contextlib.suppress(OSError),
                (self._folder / LOGS / LOG).open("a", encoding="utf-8") as file,
            ):
                file.write(f"{text}\n")
