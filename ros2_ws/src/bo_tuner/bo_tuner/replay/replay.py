"""Repeat a recorded evaluation and compare it with the record."""

from collections.abc import Mapping
from dataclasses import dataclass

from bo_tuner.backends.protocol import Backend
from bo_tuner.codec import checks
from bo_tuner.deploy.bundle import result_of
from bo_tuner.errors import RunRecordError
from bo_tuner.recording.retention import badness, evaluation_badness
from bo_tuner.storage.record import RunRecord
from bo_tuner.study.metrics import Metric
from bo_tuner.study.parts import IN_PROCESS
from bo_tuner.trials import (
    CHECKS,
    TUNING,
    Evaluation,
    TrialState,
    latest_by_place,
)
from bo_tuner.tuning.driver import Driver
from bo_tuner.tuning.recorded_method import recorded_method

BEST, WORST = "best", "worst"


@dataclass(frozen=True)
class Comparison:
    """A metric in the record and in the replay.

    Attributes
    ----------
    metric
        The metric.
    recorded, replayed
        Its values; None if the evaluation is not complete.
    judged
        Whether the replay must have the recorded value.
    at_least
        Whether the recorded value is a lower bound, of a run that was cut short.
    """

    metric: Metric
    recorded: float | None
    replayed: float | None
    judged: bool
    at_least: bool = False

    @property
    def agrees(self) -> bool:
        """Whether the values are equal, bit for bit; of a lower bound, whether it is kept."""
        if self.at_least and self.recorded is not None and self.replayed is not None:
            return self.replayed >= self.recorded
        return self.recorded == self.replayed

    @property
    def difference(self) -> float | None:
        """Replayed minus recorded value; None if one is missing."""
        if self.recorded is None or self.replayed is None:
            return None
        return self.replayed - self.recorded


@dataclass(frozen=True)
class Replay:
    """A recorded evaluation and its replay.

    Attributes
    ----------
    recorded, replayed
        The evaluation in the record, and when repeated.
    metrics
        Comparison of each metric of the study.
    """

    recorded: Evaluation
    replayed: Evaluation
    metrics: tuple[Comparison, ...]

    @property
    def same_end(self) -> bool:
        """Whether both ended in the same state, for the same reason if they failed.

        The replay of a run that was cut short is whole.
        """
        one, other = self.recorded.outcome, self.replayed.outcome
        if one.was_cut_short:
            return other.complete
        return (one.state, one.reason) == (other.state, other.reason)

    @property
    def confirmed(self) -> bool:
        """Whether the state and all judged metrics are as recorded."""
        return self.same_end and all(row.agrees for row in self.metrics if row.judged)

    @property
    def verdict(self) -> str:
        """The result in words."""
        if not self.confirmed:
            return "NOT confirmed"
        complete = self.replayed.outcome.complete
        if complete and not any(row.judged for row in self.metrics):
            return (
                "the way the test run ended is confirmed; no metric of this study is "
                "reproducible, so none was judged"
            )
        return "confirmed"


def replay(record: RunRecord, recorded: Evaluation, backend: Backend) -> Replay:
    """Run a recorded evaluation again: the same parameter set, context and seed.

    A metric that is not reproducible, such as one of measured time or of signals over ROS,
    is judged only if both the record and the replay are in process, where nothing is measured; one
    of signals also if a bag is played in lockstep, in which nodes hear and say the same again.
    """
    old = recorded
    new = Driver(backend).evaluate(old)
    bounds = old.outcome.notes.at_least
    play = None if record.study.run is None else record.study.run.play
    exact = record.backend == backend.name == IN_PROCESS
    same = play is not None and play.lockstep
    rows = tuple(
        Comparison(
            metric,
            old.outcome.metrics.get(name, bounds.get(name)),
            new.outcome.metrics.get(name),
            (metric.reproducible or exact or (same and not metric.measures_time))
            and (not bounds or name in bounds),
            at_least=name in bounds,
        )
        for name, metric in record.study.metrics.items()
    )
    return Replay(old, new, rows)


def find_trial(record: RunRecord, which: str) -> int:
    """Return the number of a trial."""
    if which == BEST:
        if record.summary is not None:
            return result_of(record).number
        checked = recorded_method(record).checked(record.study, record.trials, record.evaluations)
        best = recorded_method(record).incumbent(record.study, checked)
        if best is None:
            raise RunRecordError(f"{record.path}: no trial is complete yet, so none is best")
        return best.trial.number
    if which == WORST:
        complete = [trial for trial in record.trials if trial.state is TrialState.COMPLETE]
        if not complete:
            raise RunRecordError(f"{record.path}: no trial is complete yet, so none is worst")
        return max(complete, key=lambda trial: badness(record.study, trial)).number
    of_trials = latest_by_place(record.evaluations, (*TUNING, *CHECKS))
    numbers = {str(number): number for number in of_trials}
    if which not in numbers:
        there = numbers.values()
        trials = f"trials {min(there)} to {max(there)}" if there else "no trials yet"
        raise RunRecordError(
            f"{record.path}: no trial {checks.quoted(which)}; expected {BEST}, {WORST} or a "
            f"number, and the run has {trials}"
        )
    return numbers[which]


def find_evaluation(record: RunRecord, trial: int, index: int | None) -> Evaluation:
    """Return an evaluation of a trial, with those that checked it as a candidate."""
    evaluations = latest_by_place(record.evaluations, (*TUNING, *CHECKS))[trial]
    if index is None:
        return max(evaluations.values(), key=lambda item: evaluation_badness(record.study, item))
    if index not in evaluations:
        raise RunRecordError(
            f"{record.path}: trial {trial} has no test run {index}, only {min(evaluations)} to "
            f"{max(evaluations)}"
        )
    return evaluations[index]


def changed_provenance(record: RunRecord, now: Mapping[str, str]) -> list[str]:
    """List the changes of provenance since the record, as ``name then -> now``."""
    of_the_moment = ("started", "process", "backend", "salvaged", "salvaged_from", "study_sha256")
    return [
        f"{name} {then} -> {now[name]}"
        for name, then in record.provenance.items()
        if name in now and name not in of_the_moment and now[name] != then
    ]
