"""References over time: functions of the time since they began, vectorised.

After its end a reference keeps its last value. Phases are in rad, frequencies in Hz, and
oscillations are sines, so that they begin at their offset.

References
----------
- M. R. Schroeder, Synthesis of low-peak-factor signals and binary sequences with low
  autocorrelation, IEEE Transactions on Information Theory 16 (1970) 85-89: the phases of a
  multisine with a peak that is low for its power.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from bo_tuner.numerics.arrays import Array


def step(time: ArrayLike, initial: float, final: float, at: float) -> Array:
    """Return `initial` before the time `at` [s] and `final` from then on (n,)."""
    return np.where(np.asarray(time, dtype=np.float64) < at, initial, final)


def ramp(time: ArrayLike, initial: float, final: float, at: float, duration: float) -> Array:
    """Go from `initial` to `final` in a straight line, for `duration` [s] from `at` [s] on (n,)."""
    return np.interp(np.asarray(time, dtype=np.float64), [at, at + duration], [initial, final])


def sine(time: ArrayLike, amplitude: float, frequency: float, offset: float, phase: float) -> Array:
    """Return ``offset + amplitude sin(2 pi frequency t + phase)`` (n,)."""
    angle = 2.0 * np.pi * frequency * np.asarray(time, dtype=np.float64)
    values: Array = offset + amplitude * np.sin(angle + phase)
    return values


def chirp(
    time: ArrayLike,
    amplitude: float,
    frequencies: tuple[float, float],
    duration: float,
    offset: float,
    logarithmic: bool,
) -> Array:
    """Return a sine with a frequency that goes from one [Hz] to another in `duration` [s] (n,).

    The phase is the integral of the frequency, which is linear in time, or exponential if it is to
    take as long for each octave.
    """
    t = np.clip(np.asarray(time, dtype=np.float64), 0.0, duration)
    first, last = frequencies
    if logarithmic and first != last:
        rate = np.log(last / first) / duration
        cycles = first / rate * np.expm1(rate * t)
    else:
        cycles = first * t + 0.5 * (last - first) / duration * t**2
    values: Array = offset + amplitude * np.sin(2.0 * np.pi * cycles)
    return values


def multisine(
    time: ArrayLike,
    amplitudes: Sequence[float],
    frequencies: Sequence[float],
    phases: Sequence[float],
    offset: float,
) -> Array:
    """Return a sum of sines, each with amplitude, frequency [Hz] and phase [rad] (k,) (n,)."""
    t = np.asarray(time, dtype=np.float64)
    angles = 2.0 * np.pi * np.multiply.outer(t, np.asarray(frequencies, dtype=np.float64))
    values: Array = offset + np.sin(angles + np.asarray(phases)) @ np.asarray(amplitudes)
    return values


def schroeder_phases(count: int) -> tuple[float, ...]:
    """Return phases [rad] that keep the peak of `count` sines low (Schroeder 1970)."""
    return tuple(float(-np.pi * k * (k - 1) / count) for k in range(1, count + 1))


def interpolated(time: ArrayLike, times: Array, values: Array, hold: bool) -> Array:
    """Return a table at times (n,): in straight lines, or each value held until the next one.

    Before its first time [s] a table (k,) has its first value.
    """
    t = np.asarray(time, dtype=np.float64)
    if not hold:
        return np.interp(t, times, values)
    place = np.searchsorted(times, t, side="right") - 1
    return values[np.maximum(place, 0)]
