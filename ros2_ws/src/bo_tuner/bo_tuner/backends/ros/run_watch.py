"""Watches a run as it is recorded: whether it may go on, and when it has come to its end."""

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from bo_tuner.backends.ros.clock import RunClock
from bo_tuner.backends.ros.conditions import known, sampled
from bo_tuner.backends.ros.errors import DisturbedError
from bo_tuner.backends.ros.goals import Goal
from bo_tuner.backends.ros.own_topics import OwnTopic
from bo_tuner.backends.ros.play.player import Player
from bo_tuner.backends.ros.signals import SignalRecorder
from bo_tuner.backends.ros.streams import Streams
from bo_tuner.backends.ros.tuner_node import POLL_PERIOD, TunerNode
from bo_tuner.codec import checks
from bo_tuner.metrics.recording import CutShortError, FailedRunError
from bo_tuner.metrics.so_far import MetricsSoFar
from bo_tuner.numerics.expressions import Expression
from bo_tuner.study.braces import Values, filled_condition
from bo_tuner.study.run import Run
from bo_tuner.study.signals import TIME, Signal, expression

LOOK, PART = 0.1, 0.02
"""Time between two looks at the metrics so far: in seconds, and as a part of that of the run."""

OVERLAP = 0.5
"""Time [s] of a run that a condition is judged on again, for messages that come in late."""


class RunWatch:
    """Judges the run in progress by its signals, its goals and the clock.

    Attributes
    ----------
    aborted : float or None
        Time [s] of the run at which it was to be aborted, as far as was seen; None if it was not.
    """

    def __init__(
        self,
        run: Run,
        signals: Mapping[str, Signal],
        tuner: TunerNode,
        recorder: SignalRecorder,
        clock: RunClock,
        goals: Sequence[Goal],
        topics: Sequence[OwnTopic],
        streams: Streams,
        so_far: MetricsSoFar,
        player: Player | None = None,
    ) -> None:
        self._run = run
        self._signals = signals
        self._tuner = tuner
        self._recorder = recorder
        self._clock = clock
        self._goals = goals
        self._topics = topics
        self._streams = streams
        self._so_far = so_far
        self._player = player
        self._beyond: Mapping[str, float] = {}
        self._looked = 0.0
        self._abort = expression(run.abort_when, signals) if run.abort_when else None
        self._end: Expression | None = None
        self._when = ""
        self._judged = 0.0
        self._largest_gaps: Mapping[str, float] = {}
        self.aborted: float | None = None

    def enter(self, values: Values, beyond: Mapping[str, float]) -> None:
        """Let the condition that ends a run have values for names in braces.

        A run is cut short as soon as one of its metrics is `beyond` its value.
        """
        self._beyond = beyond
        self._when = filled_condition(self._run.end.when, values)
        self._end = expression(self._when, self._signals) if self._when else None

    def prepare(self) -> None:
        """Listen from now on to who else publishes what the steps publish."""
        for topic in self._topics:
            topic.begin()

    def expect_own_messages(self) -> None:
        """Raise `DisturbedError` if others publish what the steps publish."""
        for topic in self._topics:
            topic.take()
            if foreign := topic.foreign:
                raise DisturbedError(foreign)

    def begin(self, largest_gaps: Mapping[str, float]) -> None:
        """Start a run, with the recorder."""
        self._judged = self._looked = 0.0
        self._largest_gaps = largest_gaps
        self.aborted = None

    def wait(self, period: float) -> None:
        """Watch the run for a time [s]; raises what `judge` raises."""
        self.wait_until(self._now + period)

    def wait_until(self, end: float, held: Callable[[], bool] = lambda: False) -> None:
        """Watch the run until `end` [s], or until `held`; raises what `judge` raises."""
        while (now := self.judge(end)) < end and not held():
            self._tuner.spin_once(min(POLL_PERIOD, end - now))

    def wait_for_end(self) -> float:
        """Watch the run until it comes to its end; raises what `judge` raises."""
        end = self._run.end
        if end.after is not None:
            self.wait_until(end.after)
            return end.after
        if self._player is not None:
            return self._wait_for_bag(self._player)
        begin, timeout = self._now, self._run.timeout
        while True:
            since = self._since
            now = self.judge(timeout)
            ended = self._ended(max(since, begin), min(now, timeout))
            if ended is not None:
                return ended
            if now >= timeout:
                raise FailedRunError(f"the run does not end: {self._missing} within {timeout:g} s")
            self._tuner.spin_once(min(POLL_PERIOD, timeout - now))

    def _wait_for_bag(self, player: Player) -> float:
        while not player.is_over:
            self.judge()
            self._tuner.spin_once(POLL_PERIOD)
        self.judge()
        return player.duration

    def judge(self, end: float = np.inf) -> float:
        """See whether the run may go on, to `end` [s] at the latest; returns the time."""
        now = self._now
        self.expect_own_messages()
        self._streams.check()
        seen = min(now, end)
        since = self._since
        self.look_for_abort(now, seen)
        if self.aborted is not None:
            raise FailedRunError(self.reason_of_abort)
        if stale := self._recorder.stale:
            # Two clocks may be behind them.
            raise DisturbedError(self._recorder.mixed or stale)
        self._recorder.expect_publishers()
        if self._player is None:
            recording = self._recorder.recording(seen, since)
            recording.check_latest(self._signals, OVERLAP, self._largest_gaps)
        else:
            # How much of its time has come in depends on how fast the bag is played.
            self._player.check()
        for goal in self._goals:
            goal.check()
        self._judged = seen
        if self._beyond and now < end and now >= self._looked + max(LOOK, PART * now):
            self._looked = now
            self._expect_open()
        return now

    def _expect_open(self) -> None:
        """Raise `CutShortError` if the run is decided by its messages so far."""
        # Until the next message nobody knows how long the value of the last one holds.
        recording = self._recorder.recording(min(self._looked, self._recorder.latest))
        values = self._so_far.of(recording, self._beyond)
        if any(values[name] > self._beyond[name] for name in values):
            raise CutShortError(recording.end, self._so_far.of(recording))

    def look_for_abort(self, now: float, seen: float) -> None:
        """Take the messages that are here, and see whether the run is to be aborted by them."""
        self._recorder.poll()
        if self.aborted is None:
            # Whatever its stamp, a message that is here shows a state of the machine.
            latest = max(seen, self._recorder.latest)
            self.aborted = self._holds(self._abort, self._since, latest)
        if self.aborted is None and self._holds_late(self._abort, now):
            self.aborted = now

    @property
    def reason_of_abort(self) -> str:
        """Return why the run was to be aborted; empty if it was not."""
        if self.aborted is None:
            return ""
        return f"aborted at {self.aborted:.3f} s: {checks.quoted(self._run.abort_when)}"

    @property
    def _since(self) -> float:
        """Time [s] from which on messages are judged."""
        return max(self._judged - OVERLAP, 0.0)

    @property
    def _now(self) -> float:
        """Time since the start of the run [s]."""
        self._clock.look()
        return self._recorder.seconds

    @property
    def _missing(self) -> str:
        if not self._run.end.result:
            return f"{checks.quoted(self._when)} does not hold"
        names = [goal.name for goal in self._goals if goal.is_active]
        return f"{' and '.join(names)} has no result"

    def _ended(self, since: float, now: float) -> float | None:
        """Return when [s] the run came to its end, if it did."""
        if not self._run.end.result:
            return self._holds(self._end, since, now)
        return None if any(goal.is_active for goal in self._goals) else now

    def _holds(self, condition: Expression | None, since: float, now: float) -> float | None:
        """Return the first time [s] from `since` on at which a condition holds, if there is one."""
        if condition is None:
            return None
        times, values = sampled(condition, self._recorder.recording(now, since))
        held = np.flatnonzero(known(values) & (times >= since))
        return float(times[held[0]]) if len(held) else None

    def _holds_late(self, condition: Expression | None, now: float) -> bool:
        """Whether a condition holds by the latest messages, or a late one since the last call."""
        if condition is None:
            return False
        results = [condition(values | {TIME: now}) for values in self._recorder.take_late()]
        return any(bool(known(values).any()) for values in results)
