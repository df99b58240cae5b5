"""Numbers that describe a signal: how far off, how fast, how calm.

Each function takes the times (n,) [s], which increase, and the values (n,) of a signal that holds
each value until the next time (zero-order hold), and returns one number. Its keyword arguments are
the further keys of a metric in a study file. The value at the last time has no width.

Integrals, means and percentiles of a held signal are exact sums, whatever the distances of its
times; of a smooth signal that was sampled every h seconds an integral has an error of order h.

References
----------
.. [1] D. Graham and R. C. Lathrop, "The synthesis of 'optimum' transient response: criteria and
   standard forms", Trans. AIEE 72 (1953): the integral criteria, there of an error signal.
.. [2] Python Control Systems Library, `step_info`: overshoot, rise time and settling time, there
   of a step that starts at 0.
"""

import inspect
from collections.abc import Callable, Mapping
from types import MappingProxyType

import numpy as np

from bo_tuner.numerics.arrays import Array

STEADY_SHARE = 0.1
"""Share of the run, at its end, over which the mean is the steady state."""
ROUNDING = 1e-9
"""Relative error that sums of very many times may have."""
LEAST_STEP = 0.01
"""Least size of a step that has a progress, as a share of the range of the signal."""
LEAST_STEP_IN_NOISE = 3.0
"""Least size of a step, in changes from sample to sample of a signal that is mostly noise."""
ENOUGH_CHANGES = 10
"""Number of changes of a signal from which on the size of a typical one is known."""


class UndefinedMetricError(ValueError):
    """A signal does not have the number, such as the settling time of one that never settles."""


def iae(time: Array, value: Array) -> float:
    """Integral of the absolute value [unit s], of an error the IAE [1]_."""
    return float(np.abs(value[:-1]) @ np.diff(time))


def ise(time: Array, value: Array) -> float:
    """Integral of the squared value [unit² s], of an error the ISE [1]_."""
    return float(np.square(value[:-1]) @ np.diff(time))


def itae(time: Array, value: Array) -> float:
    """Integral of time since the first sample times absolute value [unit s²], the ITAE [1]_."""
    since = time - time[0]
    return float(np.abs(value[:-1]) @ np.diff(0.5 * np.square(since)))


def rms(time: Array, value: Array) -> float:
    """Root of the mean square over time [unit]; undefined without duration."""
    return float(np.sqrt(ise(time, value) / _positive_duration(time)))


def mean(time: Array, value: Array) -> float:
    """Mean over time [unit]; undefined without duration."""
    found = float(value[:-1] @ np.diff(time)) / _positive_duration(time)
    # The rounding error of the sum must not lead out of the range of the values.
    return float(np.clip(found, value[:-1].min(), value[:-1].max()))


def minimum(time: Array, value: Array) -> float:
    """Smallest value [unit], with its sign."""
    return float(value.min())


def maximum(time: Array, value: Array) -> float:
    """Largest value [unit], with its sign: -1 is larger than -3."""
    return float(value.max())


def std(time: Array, value: Array) -> float:
    """Root of the mean square distance over time from `mean` [unit]; undefined without duration."""
    return rms(time, value - mean(time, value))


def percentile(time: Array, value: Array, *, percent: float) -> float:
    """Smallest value [unit] that is not exceeded in `percent` of the time; undefined without any.

    `percent` is from 0, the minimum over time, to 100, the maximum.
    """
    widths = np.diff(time)
    order = np.argsort(value[:-1])
    elapsed = np.cumsum(widths[order])
    # The rounding error of the sums must not lead to the next value, nor put 100 % out of reach.
    share = percent / 100.0 * (1.0 - ROUNDING)
    wanted = min(share * _positive_duration(time), float(elapsed[-1]))
    return float(value[order[np.searchsorted(elapsed, wanted)]])


def overshoot(time: Array, value: Array, *, target: float) -> float:
    """How far a step goes beyond its target [% of the step]; 0 if it does not [2]_.

    The step is from the first value to `target`; undefined if they differ by nothing but noise.
    """
    return max(0.0, 100.0 * (float(_progress(value, target).max()) - 1.0))


def rise_time(time: Array, value: Array, *, target: float) -> float:
    """Time [s] between the first samples at 10 % and at 90 % of a step or beyond [2]_.

    The step is from the first value to `target`; undefined without a step, or if it does not get
    to 90 %.
    """
    progress = _progress(value, target)
    if progress.max() < 0.9:
        raise UndefinedMetricError(f"does not rise to 90 % of the step to {target:g}")
    return float(time[np.argmax(progress >= 0.9)] - time[np.argmax(progress >= 0.1)])


def settling_time(time: Array, value: Array, *, target: float, band: float = 0.02) -> float:
    """Time [s] from the first sample on until a step stays within a band around its target [2]_.

    The step is from the first value to `target`; the band is `band` times the step to both sides.
    Undefined without a step, or if the last value is outside.
    """
    outside = np.flatnonzero(np.abs(_progress(value, target) - 1.0) >= band)
    settled = outside[-1] + 1 if len(outside) else 0
    if settled == len(time):
        raise UndefinedMetricError(f"does not settle within {band:g} of the step to {target:g}")
    return float(time[settled] - time[0])


def steady_state_error(time: Array, value: Array, *, target: float) -> float:
    """Distance [unit] of `target` and the mean over the last tenth of the time.

    Undefined without duration.
    """
    begin = time[-1] - STEADY_SHARE * _positive_duration(time)
    # The first sample is the last one before the tenth: its value holds at the beginning.
    first = int(np.searchsorted(time, begin, side="right")) - 1
    times = np.concatenate(([begin], time[first + 1 :]))
    return abs(target - mean(times, value[first:]))


def total_variation(time: Array, value: Array) -> float:
    """Sum of all absolute changes [unit]: effort, chattering."""
    return float(np.abs(np.diff(value)).sum())


def total_variation_rate(time: Array, value: Array) -> float:
    """`total_variation` over the duration [unit/s], the same for a run of any length.

    Undefined without duration.
    """
    return total_variation(time, value) / _positive_duration(time)


def largest_rate(time: Array, value: Array) -> float:
    """Largest absolute change from sample to sample over its time [unit/s]; undefined of one."""
    if len(time) < 2:
        raise UndefinedMetricError("has no two samples")
    return float(np.abs(np.diff(value) / np.diff(time)).max())


def largest_gap(time: Array, value: Array) -> float:
    """Largest time between two samples [s]; 0 of one."""
    return float(np.diff(time).max(initial=0.0))


def duration(time: Array, value: Array) -> float:
    """Time between the first and the last sample [s]."""
    return float(time[-1] - time[0])


SignalMetricFunction = Callable[..., float]

MEASURES: Mapping[str, SignalMetricFunction] = MappingProxyType(
    {
        function.__name__: function
        for function in (
            iae, ise, itae, rms, mean, std, minimum, maximum, percentile,
            overshoot, rise_time, settling_time, steady_state_error,
            total_variation, total_variation_rate, largest_rate, largest_gap, duration,
        )
    }
)  # fmt: skip
"""The functions by the name that a study file gives them."""

SYNONYMS: Mapping[str, str] = MappingProxyType({"min": "minimum", "max": "maximum"})
"""Other names that a study file may give them."""

FROM_START = frozenset({"itae", "largest_gap", "duration"})
"""Names of those that count from the start of a run, also of a signal that begins later."""

NEVER_NEGATIVE = frozenset(MEASURES) - {"mean", "minimum", "maximum", "percentile"}
"""Names of those that are at least 0, whatever the signal."""


NEVER_FALLS = frozenset(
    {
        "iae", "ise", "itae", "maximum", "overshoot",
        "total_variation", "largest_rate", "largest_gap", "duration",
    }
)  # fmt: skip
"""Names of those that of more of the same signal are never smaller."""


def options_of(measure: str) -> dict[str, bool]:
    """Return the names of a measure's keyword arguments, and whether each is required."""
    parameters = inspect.signature(MEASURES[measure]).parameters.values()
    return {p.name: p.default is p.empty for p in parameters if p.kind is p.KEYWORD_ONLY}


def _positive_duration(time: Array) -> float:
    elapsed = float(time[-1] - time[0])
    if elapsed <= 0.0:
        raise UndefinedMetricError("has no duration")
    return elapsed


def _progress(value: Array, target: float) -> Array:
    """Return 0 at the beginning of a step and 1 at its target, shape (n,).

    There is no step if the signal begins at its target, or so near that the distance is lost in
    the noise, or far less than all that the signal moves. What the progress would be is chance.
    """
    begin = float(value[0])
    step, extent = abs(target - begin), float(np.ptp(value))
    noise = _noise(value)
    if step == 0.0 or step < LEAST_STEP_IN_NOISE * noise or step < LEAST_STEP * extent:
        beside = f", beside a range of {extent:.3g} and noise of {noise:.3g}" if step else ""
        raise UndefinedMetricError(
            f"begins at {begin:g} with the target {target:g}{beside}: that is no step"
        )
    return np.asarray((value - begin) / (target - begin))


def _noise(value: Array) -> float:
    """Return a typical change from sample to sample if the signal (n,) is mostly noise, and else 0.

    White noise turns back after two changes in three, a motion that was sampled well after few.
    """
    changes = np.diff(value)
    changes = changes[changes != 0.0]
    if len(changes) < ENOUGH_CHANGES or np.mean(changes[1:] * changes[:-1] < 0.0) < 0.5:
        return 0.0
    return float(np.median(np.abs(changes)))
