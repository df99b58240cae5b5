"""The signals of one run."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

import numpy as np

from bo_tuner.metrics.source import MissingMetricError
from bo_tuner.numerics.arrays import Array
from bo_tuner.numerics.expressions import Expression
from bo_tuner.run_notes import Messages
from bo_tuner.study.signals import TIME, Signal

OTHER_CLOCK = 5.0
"""Time [s] from which on stamps that differ from the clock of a run are of another clock."""

NO_LIMITS: Mapping[str, float] = {}


class FailedRunError(Exception):
    """A run does not count, for the reason in one line."""


class NotFiniteError(FailedRunError):
    """A signal had a value that is not finite."""


class GapError(FailedRunError):
    """A signal had no message for too long.

    Parameters
    ----------
    reason
        The reason.
    seconds
        For how long [s].
    """

    def __init__(self, reason: str, seconds: float) -> None:
        super().__init__(reason)
        self.seconds = seconds


class CutShortError(FailedRunError):
    """A run was ended early, since its outcome is decided.

    Parameters
    ----------
    seconds
        Time of the run [s].
    so_far
        By name the metrics that only grow, as they are by then.
    """

    def __init__(self, seconds: float, so_far: Mapping[str, float]) -> None:
        super().__init__(f"cut short after {seconds:.3g} s")
        self.seconds = seconds
        self.so_far = so_far


@dataclass(frozen=True)
class Recorded:
    """When the messages of a signal came.

    Attributes
    ----------
    time
        When each message was true (n,) [s] since the start of the run, increasing. The last one
        before the start, if there was one, stands first.
    lost
        Messages that the middleware lost.
    late
        Messages that were left out, as their time was not after that of the one before.
    offset
        Time [s] by which the stamp of the latest message is ahead of the clock of the run at its
        reception; negative if it is behind, 0 without a stamp.
    remark
        Why there may be no messages, in words, as far as that is known.
    """

    time: Array
    lost: int = field(default=0, kw_only=True)
    late: int = field(default=0, kw_only=True)
    offset: float = field(default=0.0, kw_only=True)
    remark: str = field(default="", kw_only=True)

    @property
    def other_clock(self) -> str:
        """Return in a few words that the stamps are of another clock; empty if they are not."""
        if abs(self.offset) <= OTHER_CLOCK:
            return ""
        side = "ahead of" if self.offset > 0.0 else "behind"
        return (
            f"its stamps are {abs(self.offset):.3g} s {side} the clock of the run: set run.clock "
            "to that of the stamps (wall or sim), or time: reception of the signal"
        )

    @property
    def messages(self) -> int:
        """Number of messages in the run."""
        return int(np.count_nonzero(self.time >= 0.0))

    def check_finite(self, where: str) -> None:
        """Raise `NotFiniteError`, with the name of the signal, if a value is not finite."""


@dataclass(frozen=True)
class RecordedSignal(Recorded):
    """A number as the messages of a signal gave it.

    Attributes
    ----------
    value
        The number in each message (n,).
    """

    value: Array

    def check_finite(self, where: str) -> None:
        """Raise `NotFiniteError`, with the name of the signal, if a value is not finite."""
        wrong = np.flatnonzero(~np.isfinite(self.value))
        if len(wrong):
            when = self.time[wrong[0]]
            raise NotFiniteError(f"{where} is {self.value[wrong[0]]:g} at {when:.3f} s")


@dataclass(frozen=True)
class RecordedMessages(Recorded):
    """The whole messages of a signal.

    Attributes
    ----------
    type
        Their type, such as `nav_msgs/msg/Path`.
    data
        Each message (n) as it is on the wire (CDR).
    """

    type: str
    data: tuple[bytes, ...]


@dataclass(frozen=True)
class Recording:
    """What was recorded in a run.

    Between two of its messages a signal has the value of the first one (zero-order hold). So
    signals have values at the same time even if their messages come at different times.

    Attributes
    ----------
    signals
        Numbers by their names in the study.
    end
        When the run ended [s] since its start.
    messages
        Signals of whole messages, by their names.
    """

    signals: Mapping[str, RecordedSignal]
    end: float
    messages: Mapping[str, RecordedMessages] = field(default_factory=dict)

    def seen(self, name: str) -> Recorded:
        """Return a signal of either kind."""
        return self.messages[name] if name in self.messages else self.signals[name]

    def check(
        self, specs: Mapping[str, Signal], largest_gaps: Mapping[str, float] = NO_LIMITS
    ) -> None:
        """Raise `FailedRunError` if a signal of the run is not whole.

        Parameters
        ----------
        specs
            The signals.
        largest_gaps
            Longest time [s] without a message, of signals whose specification has none.

        Raises
        ------
        FailedRunError
            If a signal has too few messages, too many that were lost or late, too long a time
            without one, or a value that is not finite; the message names the signal and its
            topic.
        """
        for name, spec in specs.items():
            seen = self.seen(name)
            where = named(name, spec)
            seen.check_finite(where)
            if seen.messages < spec.minimum_messages:
                before = "; the latest has a stamp before the start" if len(seen.time) else ""
                before = f"; {seen.other_clock}" if seen.other_clock else before
                before = f"; {seen.remark}" if seen.remark else before
                raise FailedRunError(
                    f"{where} has {seen.messages} messages in a run of {self.end:.3g} s, "
                    f"expected at least {spec.minimum_messages}{before}"
                )
            if spec.most_lost is not None and seen.lost + seen.late > spec.most_lost:
                raise FailedRunError(
                    f"{where} has {seen.lost} lost and {seen.late} late messages, "
                    f"expected at most {spec.most_lost}"
                )
            largest = spec.largest_gap or largest_gaps.get(name)
            if largest is not None:
                times = np.concatenate(([0.0], seen.time[seen.time >= 0.0], [self.end]))
                gaps = np.diff(times)
                k = int(gaps.argmax())
                if gaps[k] > largest:
                    raise _gap(name, spec, seen, gaps[k], times[k], largest)

    def check_finite(self, specs: Mapping[str, Signal]) -> None:
        """Raise `NotFiniteError` if a value of a signal is not finite."""
        for name, spec in specs.items():
            self.seen(name).check_finite(named(name, spec))

    def check_latest(
        self,
        specs: Mapping[str, Signal],
        late: float,
        largest_gaps: Mapping[str, float] = NO_LIMITS,
    ) -> None:
        """Raise `FailedRunError` during a run as soon as it is certain that `check` will fail it.

        Parameters
        ----------
        specs
            The signals.
        late
            Time [s] that a message may take.
        largest_gaps
            Longest time [s] without a message, of signals whose specification has none.

        Raises
        ------
        FailedRunError
            If a value is not finite, or a signal has no message any more; as by `check`.
        """
        for name, spec in specs.items():
            seen = self.seen(name)
            seen.check_finite(named(name, spec))
            since = max(0.0, seen.time[-1]) if len(seen.time) else 0.0
            largest = spec.largest_gap or largest_gaps.get(name)
            if largest is not None and self.end - since > largest + late:
                raise _gap(name, spec, seen, self.end - since, since, largest)

    def silence(self, name: str, spec: Signal) -> float:
        """Return how long [s] no message of a signal has come if that is too long, and else 0."""
        seen = self.seen(name)
        if spec.largest_gap is None or not len(seen.time):
            return 0.0
        silence = self.end - float(seen.time[-1])
        return silence if silence > spec.largest_gap else 0.0

    def sample(
        self, expression: Expression, held: bool = True, since: float = 0.0
    ) -> tuple[Array, Array]:
        """Evaluate an expression at the time of each message of its signals.

        Parameters
        ----------
        expression
            The expression.
        held
            Whether the values that hold at the start and at the end count, too.
        since
            The start [s].

        Returns
        -------
        tuple of Array
            Times (n,) [s], from `since`, or where the last of its signals begins, to the end of the
            run, and values (n,).

        Raises
        ------
        MissingMetricError
            If a signal has no message.
        """
        time, values = self.held(expression.names - {TIME}, held, since)
        evaluated = expression(values | {TIME: time})
        return time, np.broadcast_to(evaluated, time.shape).astype(np.float64)

    def held(
        self, names: Iterable[str], held: bool = True, since: float = 0.0
    ) -> tuple[Array, dict[str, Array]]:
        """Return the values of signals at the time of each message of any of them.

        Returns
        -------
        tuple
            Times (n,) [s] and by name the values (n,).
        """
        used = {name: self.signals[name] for name in names}
        for name, seen in used.items():
            if not len(seen.time):
                raise MissingMetricError(f"signal {name} has no message")
        begin = max([since, *(seen.time[0] for seen in used.values())])
        runs = [np.array([begin, self.end] if held else []), *(s.time for s in used.values())]
        stamps = np.concatenate(runs)
        # The stamps of each signal are sorted: a merge sort takes one pass. Counted along it, the
        # messages of a signal give which one holds; the last place of equal times counts them all.
        order = np.argsort(stamps, kind="stable")
        source = np.repeat(np.arange(len(runs)), [len(run) for run in runs])[order]
        time = stamps[order]
        keep = np.append(np.diff(time) > 0.0, True) & (time >= begin) & (time <= self.end)
        values = {
            name: seen.value[np.cumsum(source == k)[keep] - 1]
            for k, (name, seen) in enumerate(used.items(), start=1)
        }
        return time[keep], values

    def counts(self) -> dict[str, Messages]:
        """Return how many messages of each signal came."""
        return {
            name: Messages(seen.messages, seen.lost, seen.late)
            for name, seen in (*self.signals.items(), *self.messages.items())
        }


NOTHING_RECORDED = Recording({}, 0.0)


def named(name: str, spec: Signal) -> str:
    """Name a signal with its topic."""
    return f"signal {name} ({spec.source})"


def _gap(
    name: str, spec: Signal, seen: Recorded, length: float, since: float, largest: float
) -> GapError:
    why = "" if spec.largest_gap else ", as in the first runs; largest_gap of the signal limits it"
    why += f"; {seen.other_clock}" if seen.other_clock else ""
    return GapError(
        f"{named(name, spec)} has no message for {length:.3g} s from {since:.3f} s on, "
        f"expected one at least every {largest:.3g} s{why}",
        length,
    )
