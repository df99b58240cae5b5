"""Takes the messages of a run and has them written, a bag for each trial.

Whoever hands in a message only ever appends to a list: writing is done by a thread of its own, so
that a slow disk holds up neither the control loop nor the tuner. What waits to be written is
bounded; beyond that messages are dropped, and counted in the bag's custom data.
"""

import json
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path

from bo_tuner.metrics.recording import NOTHING_RECORDED, Recording
from bo_tuner.recording.bag import PARTIAL, Topic, TrialBag, stamp, timed
from bo_tuner.recording.inbox import Batch, Inbox
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
from bo_tuner.storage.run_files import bag_name, trial_bag
from bo_tuner.study.limits import outcome_in_words
from bo_tuner.study.study import Study
from bo_tuner.trials import TUNING, Evaluation, Trial, TrialState

MEMORY = 64_000_000
"""Most bytes of messages that wait to be written."""
QUIET, LATEST_QUIET = 0.02, 0.3
"""The last messages of a trial have come when none has for this long, at the latest then [s]."""


@dataclass
class _Open:
    """A bag that is being written.

    Attributes
    ----------
    bag
        The bag.
    key
        Its name without a part, and of a check or of the validation the worker that it is of.
    is_evidence
        Whether it is of a check or of the validation, and not of a trial.
    notes
        Metadata as far as they are known.
    evaluations
        What the metadata say of each.
    dropped, lost
        Messages that it lacks.
    """

    bag: TrialBag
    key: tuple[str, str]
    is_evidence: bool
    notes: dict[str, str] = field(default_factory=dict)
    evaluations: list[dict[str, object]] = field(default_factory=list)
    dropped: int = 0
    lost: int = 0

    @property
    def missing(self) -> dict[str, str]:
        """What the metadata say of messages that it lacks."""
        return {"dropped_messages": str(self.dropped), "lost_messages": str(self.lost)}


class Recorder:
    """Writes the bags of a run."""

    def __init__(
        self,
        folder: Path,
        study: Study,
        options: RecordOptions,
        memory: int = MEMORY,
        *,
        at_once: int = 1,
    ) -> None:
        self._folder = folder
        self._study = study
        self._options = options
        self._inbox = Inbox(QUIET, LATEST_QUIET, memory * at_once)
        self._dropped = 0
        self._lost = 0
        self._open: dict[tuple[str, str], _Open] = {}
        self._displaced = False
        self._stopped = False
        self._said = 0
        self._incomplete: list[str] = []
        self._retention: Retention | None = None
        self._writer = ThreadPoolExecutor(1, "bag-writer")
        self._submit(self._start)

    def take(self, topic: Topic, data: bytes) -> None:
        """Take a message; called from any thread."""
        if not self._stopped:
            self._inbox.take(topic, data)

    def lose(self, count: int) -> None:
        """Take note of messages that were lost on the way; called from any thread."""
        self._inbox.lose(count)

    def add(self, batch: Batch) -> None:
        """Take messages that were heard elsewhere."""
        if not self._stopped:
            self._inbox.add(batch)

    def evaluation(
        self,
        evaluation: Evaluation,
        recording: Recording = NOTHING_RECORDED,
        worker: str = "",
    ) -> None:
        """Assign what came since the last call, and the signals, to `evaluation`.

        The evaluations of a check or of the validation run at the same time on several workers:
        those of each are in a bag of their own.
        """
        self._submit(self._write, self._inbox.empty(), evaluation, recording, worker)

    def forget(self) -> None:
        """Let go of what came since the last call of `evaluation`: it belongs to none."""
        self._inbox.forget()

    def trial(self, trial: Trial, best: bool) -> None:
        """Note that a trial is complete, and whether no other is better so far."""
        self._submit(self._finish, self._inbox.empty(), trial, best)

    def phase_ended(self) -> None:
        """Note that no evaluation of a check, or of the validation, is to come for now."""
        self._submit(self._finish_evidence, self._inbox.empty())

    def warn(self, text: str) -> None:
        """Add to what `news` returns."""
        self._inbox.warn(text)

    def news(self) -> list[str]:
        """Return what went wrong since the last call, a line each."""
        news = self._inbox.warnings[self._said :]
        self._said += len(news)
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
            "warnings": list(self._inbox.warnings),
        }

    def wait_for_quiet(self, hand_over: Callable[[], object]) -> None:
        """Let the last messages come, which the listener hands over when it is told to."""
        self._inbox.wait_for_quiet(hand_over)

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
            # What a full disk has left is for the journal.
            for open_bag in self._open.values():
                open_bag.bag.discard()
            self._open.clear()

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

    def _write(
        self, batch: Batch, evaluation: Evaluation, recording: Recording, worker: str
    ) -> None:
        parameters = dict(evaluation.parameters)
        written = self._bag_of(evaluation, worker)
        signals = signal_messages(recording)
        messages = timed([*batch.messages, *signals], written.bag.latest)
        stamps = [time for message in batch.messages if (time := stamp(message)) is not None]
        outcome = evaluation.outcome
        written.evaluations.append(
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
        self._count(batch, written)
        written.notes = {
            "study": self._study.name,
            "trial": str(evaluation.trial),
            "state": "interrupted",
            "parameters": json.dumps(parameters),
            "evaluations": json.dumps(written.evaluations),
            "study_seed": str(self._study.seed),
        } | written.missing
        written.bag.write(messages, written.notes)

    def _bag_of(self, evaluation: Evaluation, worker: str) -> _Open:
        """Return the bag that takes an evaluation; made if it is the first in it."""
        is_evidence = evaluation.stage not in TUNING
        # Those of a trial run one after the other, on any workers.
        key = (bag_name(evaluation), worker if is_evidence else "")
        if key not in self._open:
            if is_evidence:
                self._finish_evidence(Batch(), worker)
            path = _free(self._folder / bag_name(evaluation))
            note_bag(path)
            self._open[key] = _Open(TrialBag(path), key, is_evidence)
        return self._open[key]

    def _finish(self, batch: Batch, trial: Trial, best: bool) -> None:
        finished = self._open.get((trial_bag(trial.number), ""))
        self._count(batch, finished)
        retention = self._retention
        if finished is None or retention is None:
            return
        reason = retention.reason(self._study, trial, best)
        finished.bag.write(timed(batch.messages, finished.bag.latest), finished.notes)
        if finished.bag.empty or not retention.wants(reason):
            finished.bag.discard()
            del self._open[finished.key]
            return
        value = badness(self._study, trial) if trial.state is TrialState.COMPLETE else None
        notes = {
            "origin": trial.origin,
            "state": str(trial.state),
            "reason": trial.reason,
            "verdict": outcome_in_words(self._study, trial),
        }
        self._keep(retention, finished, notes, reason, value)

    def _finish_evidence(self, batch: Batch, worker: str | None = None) -> None:
        """Finish the bags of a check or of the validation that are open, of a worker or of all.

        The batch is of the last of these.
        """
        evidence = [item for item in self._open.values() if item.is_evidence]
        finished = [item for item in evidence if worker in (None, item.key[1])]
        self._count(batch, finished[-1] if finished else None)
        if not finished or self._retention is None:
            return
        last = finished[-1]
        last.bag.write(timed(batch.messages, last.bag.latest), last.notes)
        for item in finished:
            self._keep(self._retention, item, {"state": "complete"}, Reason.EVIDENCE, None)

    def _keep(
        self,
        retention: Retention,
        finished: _Open,
        notes: dict[str, str],
        reason: Reason | None,
        value: float | None,
    ) -> None:
        """Finish a bag with further notes, and let others go if there is no room for it."""
        finished.bag.finish(
            finished.notes
            | finished.missing
            | notes
            | {KEPT_AS: str(reason or ""), "complete": "true"}
            | ({} if value is None else {BADNESS: repr(value)})
        )
        del self._open[finished.key]
        path = finished.bag.path
        displaced = retention.keep(path, reason, value)
        limit = f"limit of {self._options.limit / MEGABYTE:g} MB"
        if path.name in displaced:
            displaced.remove(path.name)
            self.warn(f"{path.name}: not kept, it is too large for the bags' {limit}")
        if displaced and not self._displaced:
            self._displaced = True
            self.warn(
                f"the bags have reached their {limit}: from now on the oldest are deleted, "
                f"starting with {displaced[0]}"
            )

    def _count(self, batch: Batch, written: _Open | None) -> None:
        """Count what a batch lacks, and with it its bag, and let new messages have its memory."""
        self._dropped += batch.dropped
        self._lost += batch.lost
        if written is not None:
            written.dropped += batch.dropped
            written.lost += batch.lost
        self._inbox.let_go(batch)

    def _abandon(self) -> None:
        """Leave the bags of trials that were cut short as a kill would leave them."""
        if not self._open or self._retention is None:
            return
        for item in self._open.values():
            item.bag.abandon()
        self._open.clear()
        for partial in partial_bags(self._folder):
            path = recover(partial)
            if path is not None:
                self._incomplete.append(path.name)
                self._retention.keep(path, None, None)


def _free(path: Path) -> Path:
    """Take `path`, or the first of ``<path>_part2``...: a trial that goes on keeps what it had."""
    free = path
    number = 1
    while free.exists() or free.with_name(f"{free.name}{PARTIAL}").exists():
        number += 1
        free = path.with_name(f"{path.name}_part{number}")
    return free
