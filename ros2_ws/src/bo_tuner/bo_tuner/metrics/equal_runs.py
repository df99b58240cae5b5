"""Checks of a study by equal runs of the default: whether anything moves, and how they start."""

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from bo_tuner.metrics.message_rates import fewest
from bo_tuner.metrics.recording import RecordedSignal, Recording
from bo_tuner.metrics.signal_sources import SignalSource
from bo_tuner.metrics.source import MissingMetricError
from bo_tuner.processor_load import Load, busy_share
from bo_tuner.run_notes import Rate
from bo_tuner.study.metrics import SignalMetric
from bo_tuner.study.signals import TIME, expression
from bo_tuner.study.study import Study

OF_ERRORS = ("iae", "ise", "itae", "rms", "steady_state_error")
"""Measures of an error, which differ between a signal that stands still and one that follows."""
STILL = 0.02
"""Share of such a measure by which it changes at least if the signal moves."""
MESSAGES = 10
"""Messages of a run from which on the range and the noise of a signal can be estimated."""
OLD = 10.0
"""Periods of a signal after which a value that is the latest is of a run before."""
UNLIKE = 0.1
"""Share of a signal's range by which it differs at most at the start of two equal runs."""
RARE = 0.02
"""Share of runs with too few messages that may be: such a run is remarked on by itself."""
NOISES = 4.0
"""The same in standard deviations of its noise, of which a difference of two values has 1.4."""


@dataclass(frozen=True)
class AsIfStill:
    """A metric is what it would be if these signals stood still."""

    metric: str
    signals: tuple[str, ...]


@dataclass(frozen=True)
class UnlikeStart:
    """A signal at the start of a run, and at that of the first one."""

    signal: str
    run: int
    value: float
    first: float


@dataclass(frozen=True)
class OfRunBefore:
    """A signal has a value at the start of a run, and had none at that of the first one."""

    signal: str
    run: int


@dataclass(frozen=True)
class UnevenRate:
    """A signal comes less often in one of several equal runs.

    Attributes
    ----------
    signal
        Its name.
    seldom, least
        The run in which it comes least often, and how often [1/s].
    often, most
        The run in which it comes most often, and how often [1/s].
    waited
        Share of the time for which processes waited in the first; None if it was not busy.
    """

    signal: str
    seldom: str
    least: float
    often: str
    most: float
    waited: float | None


def standing(recordings: Sequence[Recording], heard: Collection[str]) -> list[str]:
    """Return the signals that keep one value in all runs.

    Parameters
    ----------
    recordings
        Equal runs, at least one.
    heard
        Names of the signals that others publish. A signal with a single message in each run, such
        as a result, may well be the same in all.
    """
    constant = []
    for name in heard:
        seen = [recording.signals[name] for recording in recordings]
        values = np.concatenate([each.value for each in seen])
        if min(each.messages for each in seen) > 1 and np.ptp(values) == 0.0:
            constant.append(name)
    return constant


def all_stand(recordings: Sequence[Recording], heard: Collection[str]) -> bool:
    """Return whether all signals of others that come more than once in a run are `standing`."""
    often = [n for n in heard if min(each.signals[n].messages for each in recordings) > 1]
    return bool(often) and len(standing(recordings, often)) == len(often)


def unmoved(study: Study, recording: Recording, heard: Collection[str]) -> Iterator[AsIfStill]:
    """Yield the metrics that are what they would be if the signals of others stood still.

    Where a machine does not move but its signals are noisy, no signal keeps one value, but an
    error is that of its first value.

    Parameters
    ----------
    study
        The study.
    recording
        A run.
    heard
        Names of the signals that others publish. Each other one is a reference, and so is what a
        target is made of.
    """
    for name, metric in study.metrics.items():
        if not isinstance(metric, SignalMetric) or metric.measure not in OF_ERRORS:
            continue
        of = expression(metric.of, study.signals).names - {TIME}
        target = metric.target if isinstance(metric.target, str) else ""
        to = expression(target, study.signals).names - {TIME} if target else set()
        response = (of - to).intersection(heard)
        if not response or not (of | to) - response:
            continue
        still = _frozen(recording, response)
        actual, frozen = (_value(metric, study, each) for each in (recording, still))
        # Without a step of the reference there is nothing to follow.
        if frozen != 0.0 and abs(actual - frozen) <= STILL * abs(frozen):
            yield AsIfStill(name, tuple(sorted(response)))


def unlike_starts(recordings: Sequence[Recording], heard: Collection[str]) -> Iterator[UnlikeStart]:
    """Yield the signals in which equal runs do not start alike.

    Parameters
    ----------
    recordings
        Equal runs, one after the other, at least one.
    heard
        Names of the signals that others publish.
    """
    first, *others = recordings
    for name in heard:
        for number, other in enumerate(others, start=2):
            seen = [first.signals[name], other.signals[name]]
            # A signal from before the start does not depend on when the run began.
            if any(each.messages < MESSAGES or each.time[0] >= 0.0 for each in seen):
                continue
            one, two = (float(each.value[0]) for each in seen)
            span = float(np.ptp(np.concatenate([each.value for each in seen])))
            if abs(two - one) > max(UNLIKE * span, NOISES * max(map(_noise, seen))):
                yield UnlikeStart(name, number, two, one)
                break


def from_the_run_before(
    recordings: Sequence[Recording], heard: Collection[str]
) -> Iterator[OfRunBefore]:
    """Yield the signals that start the last of equal runs with a value of the one before.

    Parameters
    ----------
    recordings
        Equal runs, one after the other, at least one.
    heard
        Names of the signals that others publish.
    """
    first, last = recordings[0].signals, recordings[-1].signals
    for name in sorted(heard):
        if (first[name].time < 0.0).any() or not (last[name].time < 0.0).any():
            continue
        # What is published between runs, too, was only not heard yet when run 1 began.
        often = last[name].messages >= MESSAGES
        if not often or -last[name].time[0] > OLD * np.median(np.diff(last[name].time[1:])):
            yield OfRunBefore(name, len(recordings))


def uneven_rates(
    runs: Sequence[str],
    rates: Sequence[Mapping[str, Rate | None]],
    loads: Sequence[Load | None],
) -> dict[str, UnevenRate]:
    """Return by name the signals that come less often in one of several equal runs.

    Parameters
    ----------
    runs
        What they are called, such as ``run 1``; at least one.
    rates
        How often the signals came in each of them; one of events comes as often as they do.
    loads
        How busy the computer was in each of them; None where nobody has looked.
    """
    uneven = {}
    for name in rates[0]:
        seen = [rate for of_run in rates if (rate := of_run.get(name)) is not None and rate.even]
        if len(seen) < len(runs):
            continue
        often = [rate.messages / rate.duration for rate in seen]
        least, most = int(np.argmin(often)), int(np.argmax(often))
        too_few = [rate for rate in seen if rate.messages < fewest(often[most] * rate.duration)]
        if len(too_few) <= RARE * len(seen):
            continue
        uneven[name] = UnevenRate(
            name, runs[least], often[least], runs[most], often[most], busy_share(loads[least])
        )
    return uneven


def _noise(seen: RecordedSignal) -> float:
    """Return the standard deviation of a signal's noise, if the signal is smooth without it.

    The second difference of white noise has six times its variance.
    """
    bends = np.diff(seen.value, 2)
    return float(np.median(np.abs(bends)) / 0.6745 / np.sqrt(6.0)) if len(bends) else 0.0


def _frozen(recording: Recording, names: Collection[str]) -> Recording:
    """Return a run in which signals keep their first value."""
    signals: Mapping[str, RecordedSignal] = {
        name: RecordedSignal(
            seen.time, np.full(len(seen.value), seen.value[0]) if name in names else seen.value
        )
        for name, seen in recording.signals.items()
    }
    return Recording(signals, recording.end)


def _value(metric: SignalMetric, study: Study, recording: Recording) -> float:
    """Return the value of a metric in a run; NaN, which equals none, if it is undefined."""
    try:
        return SignalSource(metric, study, lambda: recording).value({})
    except MissingMetricError:
        return float("nan")
