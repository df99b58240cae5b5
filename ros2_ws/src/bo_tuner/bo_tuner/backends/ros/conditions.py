"""What recorded signals say of a condition, also while some have no message yet."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from bo_tuner.metrics.recording import RecordedSignal, Recording
from bo_tuner.numerics.arrays import Array
from bo_tuner.numerics.expressions import Expression
from bo_tuner.study.signals import Signal

UNKNOWN = RecordedSignal(np.array([0.0]), np.array([np.nan]))
"""A signal without a message."""


def sampled(condition: Expression, recording: Recording, since: float = 0.0) -> tuple[Array, Array]:
    """Return times (n,) from `since` on [s] and values (n,), NaN where a message would decide."""
    signals = {
        name: seen if len(seen.time) else UNKNOWN for name, seen in recording.signals.items()
    }
    return Recording(signals, recording.end).sample(condition, since=since)


def known(values: Array) -> NDArray[np.bool_]:
    """Return where a condition of these values (n,) is known to hold."""
    return np.isfinite(values) & (values != 0.0)


class Edge:
    """Looks for a condition that comes to hold, and holds for a time."""

    def __init__(self, hold: float) -> None:
        self._hold = hold
        self._since: float | None = None
        self._off: float | None = None

    @property
    def was_off(self) -> bool:
        """Whether it was known not to hold at any time."""
        return self._off is not None

    def look(self, times: Array, values: Array) -> bool:
        """Take its values (n,) at times (n,) [s], up to now; whether it has come to hold for long.

        What was taken before may come again, with what has come in meanwhile.
        """
        for time, value in zip(times, values, strict=True):
            if self._since is not None and time - self._since >= self._hold:
                return True
            if np.isnan(value):
                self._since = None
            elif value == 0.0:
                self._off = time if self._off is None else min(self._off, time)
                self._since = None
            elif self._off is not None and time > self._off and self._since is None:
                self._since = float(time)
        return self._since is not None and float(times[-1]) - self._since >= self._hold


def latest(specs: Mapping[str, Signal], recording: Recording) -> str:
    """Tell in brackets the latest values of signals, and between which they were since time 0.

    Empty if there are none.
    """
    shown = []
    for name, spec in sorted(specs.items()):
        values = recording.signals[name].value
        text = f"{name} {values[-1]:.4g}" if len(values) else f"no message of {name}"
        meanwhile = values[recording.signals[name].time >= 0.0]
        if len(meanwhile) and np.ptp(meanwhile) > 0.0:
            text += f", {np.min(meanwhile):.4g} to {np.max(meanwhile):.4g} meanwhile"
        if silence := recording.silence(name, spec):
            text += f", silent for {silence:.3g} s"
        if other_clock := recording.signals[name].other_clock:
            text += f"; {other_clock}"
        shown.append(text)
    return f" ({'; '.join(shown)})" if shown else ""
