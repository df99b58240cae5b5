"""How often the messages of a signal come, and what to make of it when none comes for long.

Where a study does not limit the gaps of a signal, the first complete runs show what is usual. A
signal with messages in even distances there is *regular*; one of events, or of something that is
published only once, is not, and may be silent.
"""

from collections.abc import Collection
from dataclasses import astuple, replace
from statistics import median

import numpy as np

from bo_tuner.metrics.recording import RecordedSignal, Recording, named
from bo_tuner.numerics.arrays import Array
from bo_tuner.run_notes import Rate
from bo_tuner.study.braces import without_names
from bo_tuner.study.metrics import signals_of
from bo_tuner.study.signals import expression
from bo_tuner.study.study import Study
from bo_tuner.trials import Outcome

FIRST_RUNS = 3
"""Complete runs that show what is usual."""
FEWEST = 10
"""Messages in a run from which on their distance can be estimated."""
REGULAR, NOTED = 3.0, 5.0
"""Largest gap of a regular signal, and of one that is worth a note, in usual distances."""
JITTER = 0.1
"""Length [s] of a gap that is usual on a busy machine, however often messages come."""
FEWEST_SHARE = 0.95
"""Share of the usual number of messages that an even signal has at least, or they are too few."""
LONG = 50.0
"""A gap of so many usual distances fails a run, if it is long beside the run as well."""
SHARE, SHORTEST, LONGEST = 0.25, 0.5, 2.0
"""Share of the run that such a gap takes at least, between these lengths [s]."""


def rate_of(seen: RecordedSignal, end: float) -> Rate | None:
    """Return the rate of a signal in a run until `end` [s]; None of too few messages."""
    times = seen.time[seen.time >= 0.0]
    if len(times) < FEWEST:
        return None
    gap = float(np.max(gaps(times, end)))
    distance, most = map(float, np.quantile(np.diff(times), [0.5, 0.9]))
    return Rate(len(times), distance, most, gap, end)


def fewest(expected: float) -> float:
    """Return the least number of messages that is as usual, where so many are expected."""
    return FEWEST_SHARE * expected - 1.0


def gaps(times: Array, end: float) -> Array:
    """Return the times [s] without a message (n + 1,), from the times of the messages (n,)."""
    return np.diff(np.concatenate(([0.0], times, [end])))


class MessageRates:
    """What is usual of the signals of a study, by its first complete runs.

    It depends on their outcomes alone, in their order, so that a run that is resumed has the same
    as one that is not.

    Parameters
    ----------
    study
        The study.
    """

    def __init__(self, study: Study) -> None:
        # A signal with a `largest_gap` is judged by that; one that need not come may be silent, and
        # so may those of a bag, which has its own gaps.
        self._signals = {
            name: spec
            for name, spec in study.signals.items()
            if spec.largest_gap is None and spec.minimum_messages > 0 and not study.plays_bags
        }
        self._all = list(study.signals)
        self._used = used_signals(study)
        self._runs: list[dict[str, Rate]] = []

    def note(self, outcome: Outcome) -> None:
        """Take note of the rates that the outcome of an evaluation has."""
        rates = outcome.notes.rates
        if outcome.complete and rates and len(self._runs) < FIRST_RUNS:
            self._runs.append({name: rate for name, rate in rates.items() if rate is not None})

    def of(self, recording: Recording) -> dict[str, Rate | None]:
        """Return the rates of a run; None of a signal with too few messages."""
        return {
            name: rate_of(recording.signals[name], recording.end)
            for name in self._all
            if name in recording.signals
        }

    @property
    def largest_gaps(self) -> dict[str, float]:
        """Time [s] without a message that fails a run, of each regular signal that is used.

        Empty until the first runs have shown what is usual.
        """
        return {
            name: max(
                LONG * rate.distance,
                4.0 * rate.gap,
                min(max(SHARE * rate.duration, SHORTEST), LONGEST),
            )
            for name, rate in self._usual.items()
            if name in self._used
        }

    def remarks(self, recording: Recording) -> list[str]:
        """Return a line on each signal that was silent for longer than usual, or too rare.

        In the first runs a signal is compared with itself.
        """
        remarks = []
        for name, spec in self._signals.items():
            seen = recording.signals.get(name)
            rate = self._usual.get(name)
            if seen is not None and len(self._runs) < FIRST_RUNS:
                rate = rate_of(seen, recording.end)
                rate = rate and replace(rate, messages=0.0, gap=0.0)
            if seen is not None and rate is not None:
                remarks += _remarks(named(name, spec), seen, recording.end, rate)
        return remarks

    @property
    def _usual(self) -> dict[str, Rate]:
        """What is usual of each regular signal: the medians of the first runs."""
        if len(self._runs) < FIRST_RUNS:
            return {}
        usual = {}
        for name in self._signals:
            rates = [run[name] for run in self._runs if name in run]
            if len(rates) <= FIRST_RUNS // 2:
                continue
            medians = zip(*(astuple(rate) for rate in rates), strict=True)
            rate = Rate(*map(median, medians))
            if rate.gap <= max(REGULAR * rate.distance, JITTER):
                usual[name] = rate
        return usual


def _remarks(where: str, seen: RecordedSignal, end: float, usual: Rate) -> list[str]:
    times = seen.time[seen.time >= 0.0]
    silent = gaps(times, end)
    k = int(silent.argmax())
    if silent[k] > max(NOTED * usual.distance, 2.0 * usual.gap, JITTER):
        since = [0.0, *times][k]
        return [
            f"{where} has no message for {silent[k]:.3g} s from {since:.3f} s on, usually one "
            f"every {usual.distance:.3g} s"
        ]
    expected = usual.messages * end / usual.duration
    if usual.even and len(times) < fewest(expected):
        return [f"{where} has {len(times)} messages, usually about {expected:.0f}"]
    return []


def used_signals(study: Study) -> Collection[str]:
    """Return the signals that a metric, or a condition on the end or abortion of a run, needs."""
    used = {name for m in study.metrics.values() for name in signals_of(m, study.signals)}
    if study.run is not None:
        for text in (study.run.abort_when, study.run.end.when):
            if text:
                used |= expression(without_names(text), study.signals).names
    return used
