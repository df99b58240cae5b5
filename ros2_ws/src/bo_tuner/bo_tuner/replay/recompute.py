"""Metrics of recorded runs, computed again from their bags, or from what nodes reported."""

import dataclasses
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial

from bo_tuner.errors import RunRecordError
from bo_tuner.metrics.collect import Collector
from bo_tuner.metrics.recording import NOTHING_RECORDED, FailedRunError
from bo_tuner.metrics.signal_sources import signal_sources
from bo_tuner.recording.retention import is_bag
from bo_tuner.recording.signal_bag import RecordedRun, recorded_runs
from bo_tuner.storage.record import RunRecord
from bo_tuner.storage.run_files import BAGS
from bo_tuner.study.metrics import CombinedMetric, ReportedMetric, StudyMetric
from bo_tuner.study.signals import Signal
from bo_tuner.study.study import Study
from bo_tuner.trials import TUNING, Evaluation, EvaluationState, Outcome
from bo_tuner.tuning.carrying import Measure, remeasured


@dataclass(frozen=True)
class Recomputed:
    """A recorded run with its metrics as computed again.

    Attributes
    ----------
    run
        The run.
    outcome
        Of the recomputed metrics.
    """

    run: RecordedRun
    outcome: Outcome


def check_recorded(record: RunRecord, study: Study) -> None:
    """Refuse a study with metrics that a run's bags do not give."""
    recorded = record.study.signals
    for name, metric in study.metrics.items():
        if isinstance(metric, ReportedMetric):
            raise RunRecordError(
                f"{record.path}: metric {name} is reported by a node, and not computed from signals"
            )
    for name, signal in study.signals.items():
        known = recorded.get(name)
        if known is None or _source(known) != _source(signal):
            raise RunRecordError(
                f"{record.path}: has no recording of signal {name} ({signal.source} "
                f"{signal.field or 'whole messages'}); it has {', '.join(recorded) or 'none'}"
            )


def recompute(
    record: RunRecord, study: Study, interrupted: Callable[[], None] = lambda: None
) -> Iterator[Recomputed]:
    """Compute the metrics of a study for every run in the bags of a record, in their order.

    Metrics that are relative to the default are left out: the runs of the default are in no bag.
    """
    check_recorded(record, study)
    recording = NOTHING_RECORDED
    any_run = False
    with signal_sources(study, lambda: recording, interrupted) as sources:
        collector = Collector(study, sources)
        for bag in sorted(filter(is_bag, (record.path / BAGS).glob("*"))):
            for run in recorded_runs(bag):
                any_run, recording = True, run.recording
                yield Recomputed(run, _outcome(study, run, collector))
    if not any_run:
        raise RunRecordError(
            f"{record.path}: has no bag with signals; tune with --record notable or all"
        )


def measure_again(record: RunRecord, study: Study) -> Measure:
    """Return what computes the metrics of another study for the trials of a record."""
    # The default's runs beside the evaluations are in no bag.
    anew = [
        study.metrics[name]
        for name in remeasured(record.study, study)
        if name not in study.relative_metrics
    ]
    if not anew:
        return lambda evaluation: None
    parts = [
        part
        for metric in anew
        for part in (metric.parts if isinstance(metric, CombinedMetric) else (metric,))
    ]
    reported = [metric for metric in parts if isinstance(metric, ReportedMetric)]
    if reported:
        return partial(_from_reports, study, reported)
    runs = {
        (recomputed.run.trial, recomputed.run.evaluation["index"]): recomputed
        for recomputed in recompute(record, study)
        if recomputed.run.evaluation.get("stage") in TUNING
        and recomputed.run.evaluation.get("state") == EvaluationState.COMPLETE
    }

    def measure(evaluation: Evaluation) -> Outcome | None:
        recomputed = runs.get((evaluation.trial, evaluation.index))
        # What the run has taken from another one is not in its bags.
        if recomputed is None or recomputed.run.evaluation["metrics"] != evaluation.outcome.metrics:
            return None
        return recomputed.outcome

    return measure


def _from_reports(
    study: Study, reported: Sequence[ReportedMetric], evaluation: Evaluation
) -> Outcome | None:
    """Compute metrics of what the nodes have reported; None if a figure is not among that."""
    details = evaluation.outcome.details
    if any(f"{metric.node}.{metric.key}" not in details for metric in reported):
        return None
    results = {
        node: {
            key.removeprefix(f"{node}."): value
            for key, value in details.items()
            if key.startswith(f"{node}.")
        }
        for node in study.nodes
    }
    return Collector(study).outcome({node: pairs for node, pairs in results.items() if pairs})


def _source(signal: Signal) -> Signal:
    """Return what decides which values a signal has, at which times: not what it must keep."""
    return dataclasses.replace(
        signal, type="", minimum_messages=1, largest_gap=None, most_lost=None
    )


def differing(record: RunRecord, study: Study, recomputed: Recomputed) -> list[str]:
    """Return the metrics of equal definition with another value than the recorded one.

    If no metric of the run's own study can be computed any more, all of them differ.
    """
    if not recomputed.outcome.complete and study != record.study:
        # A metric of the other study may be what failed.
        return []
    return [
        name
        for name, value in recomputed.run.evaluation.get("metrics", {}).items()
        if name in study.metrics
        and name not in study.relative_metrics
        and _defined_alike(study.metrics[name], record.study.metrics.get(name))
        and recomputed.outcome.metrics.get(name) != value
    ]


def _defined_alike(one: StudyMetric, other: StudyMetric | None) -> bool:
    """Return whether two metrics are equal, and, if they are computed from others, those too."""
    return one == other and getattr(one, "parts", ()) == getattr(other, "parts", ())


def _outcome(study: Study, run: RecordedRun, collector: Collector) -> Outcome:
    try:
        run.recording.check(study.signals)
    except FailedRunError as error:
        return Outcome(EvaluationState.FAILED, {}, str(error))
    return collector.outcome({})
