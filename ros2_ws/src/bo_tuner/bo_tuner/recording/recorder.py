"""Takes the messages of a run and has them written, a bag for each trial.

Whoever hands in a message only ever appends to a list: writing is done by a thread of its own, so
that a slow disk holds up neither the control loop nor the tuner. What waits to be written is
bounded; beyond that messages are dropped, and counted in the bag's custom data.
"""

import json
import threading
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path

from bo_tuner.metrics.recording import NOTHING_RECORDED, Recording
from bo_tuner.recording.bag import Message, Topic, TrialBag, stamp, timed
from bo_tuner.recording.recovery import partial_bags, recover
from bo_tuner.recording.retention import (
    BADNESS,
    KEPT_AS,
    MEGABYTE,
    Reason,
    RecordOptions,
    Retention,
    badness,
    note_bag,
)
from bo_tuner.recording.signal_bag import RECORDING, recording_note, signal_messages
from bo_tuner.storage.run_files import bag_name
from bo_tuner.study.limits import outcome_in_words
from bo_tuner.study.study import Study
from bo_tuner.trials import TUNING, Evaluation, Trial, TrialState

MEMORY = 64_000_000
"""Most bytes of messages that wait to be written."""
QUIET, LATEST_QUIET = 0.02, 0.3
"""The last messages of a trial have come when none has for this long, at the latest then [s]."""


@dataclass
class _Batch:
    """Messages of an evaluation, their size, and how many are missing.

    Dropped are those for which there was no memory, lost those that the middleware lost.
    """

    messages: list[Message] = field(default_factory=list)
    size: int = 0
    dropped: int = 0
    lost: int = 0


class Recorder:
    """Writes the bags of a run.

    Parameters
    ----------
    folder
        Takes the bags; made with the first.
    study
        The study.
    options
        What to record.
    memory
        Most bytes that wait to be written.
    """

    def __init__(
        self, folder: Path, study: Study, options: RecordOptions, memory: int = MEMORY
    ) -> None:
        self._folder = folder
        self._study = study
        self._options = options
        self._memory = memory
        self._lock = threading.Lock()
        self._batch = _Batch()
        self._waiting = 0
        self._dropped = 0
        self._lost = 0
        self._bag: TrialBag | None = None
        self._bag_name = ""
        self._notes: dict[str, str] = {}
        self._evaluations: list[dict[str, object]] = []
        self._bag_missing = _Batch()
        self._displaced = False
        self._stopped = False
        self._news: list[str] = []
        self._said: list[str] = []
        self._incomplete: list[str] = []
        self._retention: Retention | None = None
        self._writer = ThreadPoolExecutor(1, "bag-writer")
        self._submit(self._start)

    def take(self, topic: Topic, data: bytes) -> None:
        """Take a message; called from any thread."""
        with self._lock:
            if self._stopped:
                return
            if self._waiting + len(data) > self._memory:
                self._batch.dropped += 1
                return
            self._waiting += len(data)
            self._batch.size += len(data)
            self._batch.messages.append((topic, data))

    def lose(self, count: int) -> None:
        """Take note of messages that were lost on the way; called from any thread."""
        with self._lock:
            self._batch.lost += count

    def evaluation(self, evaluation: Evaluation, recording: Recording = NOTHING_RECORDED) -> None:
        """Assign what came since the last call, and the signals, to `evaluation`."""
        self._submit(self._write, self._take_batch(), evaluation, recording)

    def forget(self) -> None:
        """Let go of what came since the last call of `evaluation`: it belongs to none."""
        batch = self._take_batch()
        with self._lock:
            self._waiting -= batch.size

    def trial(self, trial: Trial, best: bool) -> None:
        """Note that a trial is complete, and whether no other is better so far."""
        self.wait_for_quiet()
        self._submit(self._finish, self._take_batch(), trial, best)

    def phase_ended(self) -> None:
        """Note that no evaluation of a check, or of the validation, is to come for now."""
        self.wait_for_quiet()
        self._submit(self._finish_evidence, self._take_batch())

    def warn(self, text: str) -> None:
        """Add to what `news` returns."""
        with self._lock:
            self._news.append(text)

    def news(self) -> list[str]:
        """Return what went wrong since the last call, a line each."""
        with self._lock:
            news, self._news = self._news, []
        self._said += news
        return news

    def close(self) -> dict[str, object]:
        """Finish what is open, as incomplete; returns a summary of the recording."""
        self._submit(self._abandon)
        self._writer.shutdown()
        self._stopped = True
        return {
            "policy": str(self._options.policy),
            "bags": self._retention.kept if self._retention else [],
            "incomplete": self._incomplete,
            "dropped_messages": self._dropped,
            "lost_messages": self._lost,
            "warnings": [*self._said, *self._news],
        }

    def _take_batch(self) -> _Batch:
        with self._lock:
            batch, self._batch = self._batch, _Batch()
        return batch

    def wait_for_quiet(self) -> None:
        """Let the last messages come: topics have no order between them."""
        end = time.monotonic() + LATEST_QUIET
        count = -1
        while count != len(self._batch.messages) and time.monotonic() < end:
            count = len(self._batch.messages)
            time.sleep(QUIET)

    def _submit(self, work: Callable[..., None], *arguments: object) -> None:
        self._writer.submit(self._attempt, work, *arguments)

    # All below runs in the writer's thread.

    def _attempt(self, work: Callable[..., None], *arguments: object) -> None:
        if self._stopped:
            return
        try:
            work(*arguments)
        # Whatever it is, a bag is not worth a run; and nobody would see it in this thread.
        except Exception as error:
            self._stopped = True
            reason = error.strerror if isinstance(error, OSError) else ""
            self.warn(
                f"recording stopped: {self._folder}: {reason or repr(error)}; the run goes on"
            )
            if self._bag is not None:
                # What a full disk has left is for the journal.
                self._bag.discard()
                self._bag = None

    def _start(self) -> None:
        self._folder.mkdir(exist_ok=True)
        for partial in partial_bags(self._folder):
            path = recover(partial)
            if path is None:
                self.warn(f"{partial.name}: cut off before a whole test run; nothing to recover")
            else:
                note_bag(path)
                self._incomplete.append(path.name)
                self.warn(f"{path.name}: cut off; recovered as far as it was written")
        self._retention = Retention(self._folder, self._options)

    def _write(self, batch: _Batch, evaluation: Evaluation, recording: Recording) -> None:
        parameters = dict(evaluation.parameters)
        if evaluation.stage not in TUNING and self._bag_name != bag_name(evaluation):
            self._finish_evidence(_Batch())
        if self._bag is None:
            self._bag_name = bag_name(evaluation)
            path = _free(self._folder / self._bag_name)
            note_bag(path)
            self._bag = TrialBag(path)
            self._bag_missing = _Batch()
            self._evaluations = []
        signals = signal_messages(recording)
        messages = timed([*batch.messages, *signals], self._bag.latest)
        stamps = [time for message in batch.messages if (time := stamp(message)) is not None]
        outcome = evaluation.outcome
        self._evaluations.append(
            {
                "trial": evaluation.trial,
                "index": evaluation.index,
                "stage": str(evaluation.stage),
                "parameters": parameters,
                "context": dict(evaluation.context),
                "seed": evaluation.seed,
                "state": str(outcome.state),
                "reason": outcome.reason,
                "metrics": dict(outcome.metrics),
                "start": min(stamps, default=None),
                "end": max(stamps, default=None),
                RECORDING: recording_note(recording),
            }
        )
        self._count(batch)
        self._notes = {
            "study": self._study.name,
            "trial": str(evaluation.trial),
            "state": "interrupted",
            "parameters": json.dumps(parameters),
            "evaluations": json.dumps(self._evaluations),
            "study_seed": str(self._study.seed),
        } | self._missing()
        self._bag.write(messages, self._notes)

    def _finish(self, batch: _Batch, trial: Trial, best: bool) -> None:
        self._count(batch)
        bag, retention = self._bag, self._retention
        if bag is None or retention is None:
            return
        reason = retention.reason(self._study, trial, best)
        bag.write(timed(batch.messages, bag.latest), self._notes)
        if bag.empty or not retention.wants(reason):
            bag.discard()
            self._bag = None
            return
        value = badness(self._study, trial) if trial.state is TrialState.COMPLETE else None
        notes = {
            "origin": trial.origin,
            "state": str(trial.state),
            "reason": trial.reason,
            "verdict": outcome_in_words(self._study, trial),
        }
        self._keep(retention, bag, notes, reason, value)

    def _finish_evidence(self, batch: _Batch) -> None:
        """Finish the bag of a check or of the validation, if one is open."""
        self._count(batch)
        bag, retention = self._bag, self._retention
        if bag is None or retention is None:
            return
        bag.write(timed(batch.messages, bag.latest), self._notes)
        self._keep(retention, bag, {"state": "complete"}, Reason.EVIDENCE, None)

    def _keep(
        self,
        retention: Retention,
        bag: TrialBag,
        notes: dict[str, str],
        reason: Reason | None,
        value: float | None,
    ) -> None:
        """Finish a bag with further notes, and let others go if there is no room for it."""
        bag.finish(
            self._notes
            | self._missing()
            | notes
            | {KEPT_AS: str(reason or ""), "complete": "true"}
            | ({} if value is None else {BADNESS: repr(value)})
        )
        self._bag = None
        displaced = retention.keep(bag.path, reason, value)
        limit = f"limit of {self._options.limit / MEGABYTE:g} MB"
        if bag.path.name in displaced:
            displaced.remove(bag.path.name)
            self.warn(f"{bag.path.name}: not kept, it is too large for the bags' {limit}")
        if displaced and not self._displaced:
            self._displaced = True
            self.warn(
                f"the bags have reached their {limit}: from now on the oldest are deleted, "
                f"starting with {displaced[0]}"
            )

    def _count(self, batch: _Batch) -> None:
        """Count what a batch lacks, and let new messages have its memory."""
        self._bag_missing.dropped += batch.dropped
        self._bag_missing.lost += batch.lost
        self._dropped += batch.dropped
        self._lost += batch.lost
        with self._lock:
            self._waiting -= batch.size

    def _missing(self) -> dict[str, str]:
        return {
            "dropped_messages": str(self._bag_missing.dropped),
            "lost_messages": str(self._bag_missing.lost),
        }

    def _abandon(self) -> None:
        """Leave the bag of a trial that was cut short as a kill would leave it."""
        if self._bag is None or self._retention is None:
            return
        self._bag.abandon()
        self._bag = None
        for partial in partial_bags(self._folder):
            path = recover(partial)
            if path is not None:
                self._incomplete.append(path.name)
                self._retention.keep(path, None, None)


def _free(path: Path) -> Path:
    """Take `path`, or the first of ``<path>_part2``...: a trial that goes on keeps what it had."""
    free = path
    number = 1
    while free.exists():
        number += 1
        free = path.with_name(f"{path.name}_part{number}")
    return free
