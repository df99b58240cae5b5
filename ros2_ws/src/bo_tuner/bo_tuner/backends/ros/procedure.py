"""Performs the run of a study on nodes that know nothing of the tuner."""

import contextlib
import time
from collections.abc import Callable, Collection, Mapping, Sequence
from functools import partial
from itertools import takewhile

import numpy as np
from rclpy.duration import Duration

from bo_tuner.backends.ros.clock import RunClock, SimClock, Stopwatch, WallClock
from bo_tuner.backends.ros.conditions import Edge, latest, sampled
from bo_tuner.backends.ros.errors import DisturbedError, LostError, RefusedError, SilentError
from bo_tuner.backends.ros.goals import Goal
from bo_tuner.backends.ros.guard.link import GuardActedError, GuardLink
from bo_tuner.backends.ros.own_topics import OwnTopic
from bo_tuner.backends.ros.parameters.nodes import NodeParameters
from bo_tuner.backends.ros.parameters.services import meet
from bo_tuner.backends.ros.play.player import Player
from bo_tuner.backends.ros.preparation import Preparation
from bo_tuner.backends.ros.publication import UnheardError
from bo_tuner.backends.ros.run_watch import OVERLAP, RunWatch
from bo_tuner.backends.ros.signals import SignalRecorder
from bo_tuner.backends.ros.steps import CONNECT_TIMEOUT, PreparedStep
from bo_tuner.backends.ros.streams import Stream, Streams
from bo_tuner.backends.ros.study_client import LONGEST_LEASE
from bo_tuner.backends.ros.ticks import SimTicks, Ticks, WallTicks
from bo_tuner.backends.ros.tuner_node import POLL_PERIOD, TunerNode
from bo_tuner.codec import checks
from bo_tuner.codec.findings import under
from bo_tuner.errors import BackendError, KeyPath, StudyError, dotted
from bo_tuner.metrics.latest_messages import LatestMessage, LatestMessages
from bo_tuner.metrics.recording import (
    NOTHING_RECORDED,
    FailedRunError,
    Recording,
)
from bo_tuner.metrics.so_far import MetricsSoFar
from bo_tuner.run_notes import Published
from bo_tuner.study.braces import filled_condition
from bo_tuner.study.run import AFTER, BEFORE, RECOVER, REST, SIM, START, Run
from bo_tuner.study.signals import TIME, expression
from bo_tuner.study.step_values import filled_step, varies
from bo_tuner.study.steps import Step, WaitUntil
from bo_tuner.study.study import Study
from bo_tuner.trials import Context, Value

DISCOVERED = 2.0
"""Time [s] in which the publisher of a node that was just started is known."""
FIRST_MESSAGES = 2.0
"""Time [s] in which a node that was started anew publishes what it has published before."""
ENDED = 1.0
"""Time [s] in which the publishers of a node that has ended are known to be gone."""
ACKNOWLEDGED = 1
"""Time [s] in which the last messages reach those who are still there."""
NOT_SETTLED = (
    "try a longer timeout, a wider condition, other gains in park, or to reset the controller "
    "ahead of it"
)
"""What to do about a machine that does not come to where a run is to start."""
TOO_SLOW = (
    "the parameters of the trial may be too slow for it: let the safe ones do it "
    "(park: {between_runs: true}), reset the machine ahead of it, or give it a longer timeout"
)
"""The same where it goes there with the parameters of the run before, and of the next."""
OWN_FAULTS = (FailedRunError, RefusedError, DisturbedError, BackendError, StudyError)
"""What a step may raise for itself: to repeat it would not help."""
FAULTS = (*OWN_FAULTS, LostError)
"""What a step may raise; others end the whole run."""


class Procedure:
    """Runs of a study, one after the other.

    Attributes
    ----------
    recording : Recording
        What was recorded of the last run.
    before_abort : sequence of LatestMessage
        What the signals said in the 5 s until the last run was aborted; empty if it was not.
    """

    def __init__(
        self,
        study: Study,
        run: Run,
        tuner: TunerNode,
        parameters: NodeParameters,
        restart: Callable[[Sequence[str]], None] | None,
        guard: GuardLink | None = None,
    ) -> None:
        self._run = run
        self._study = study
        self._tuner = tuner
        self._parameters = parameters
        self._restart = restart
        self._guard = guard
        guarded = () if guard is None else guard.topics
        self._latest_messages = LatestMessages()
        may_be_aborted = bool(run.abort_when) or guard is not None
        keep = self._latest_messages.add if may_be_aborted else None
        self._recorder = SignalRecorder(tuner.context, study.signals, guarded, keep)
        self._clock: RunClock = WallClock()
        self.recording = NOTHING_RECORDED
        self.before_abort: Sequence[LatestMessage] = ()
        self._steps: dict[KeyPath, PreparedStep] = {}
        self._goals: dict[KeyPath, Goal] = {}
        self._topics: dict[str, OwnTopic] = {}
        self._prepared_streams: dict[KeyPath, Stream] = {}
        self._streams = Streams(tuner)
        self._player: Player | None = None
        self._started: list[Goal] = []
        self._is_recording = False
        self._is_prepared = False
        self._is_ready = False
        self._due: list[int] = []
        self._since_run: Stopwatch | None = None
        space = study.context_space()
        # What is performed ahead of any evaluation is in the nominal context.
        self._context: Context = space.to_dict(space.nominal())
        self._safe = self._parameters_of_run = study.safe_parameters
        try:
            self._connect()
            self._watch = RunWatch(
                run,
                study.signals,
                tuner,
                self._recorder,
                self._clock,
                self._started,
                list(self._topics.values()),
                self._streams,
                MetricsSoFar(study),
                self._player,
            )
            self._watch.enter(self._values(), {})
        except BaseException:
            self.close()
            raise

    def expect_rest(self) -> None:
        """Raise `LostError` if a goal of an earlier run does not end; it is waited for."""
        problems = self._cancel()
        # A goal that is not accepted yet is cancelled once it is, and does not block all runs.
        self._started[:] = [goal for goal in self._started if goal.is_active]
        if problems:
            raise LostError("; ".join(problems))

    def enter(
        self, parameters: Mapping[str, Value], context: Context, beyond: Mapping[str, float]
    ) -> None:
        """Let the steps that follow have the values of a context and, until it ends, of a set.

        A run is cut short as soon as one of its metrics is `beyond` its value.
        """
        self._parameters_of_run, self._context = {**self._safe, **parameters}, context
        self._fill()
        self._watch.enter(self._values(), beyond)

    def rest(self) -> float:
        """Wait until the machine has rested since the last run; returns for how long [s]."""
        rest = self._run.rest
        if rest is None:
            return 0.0
        self._clock.update()
        watch = Stopwatch(self._clock)
        rested = rest.at_least if self._since_run is None else self._since_run.seconds
        if rested < rest.at_least:
            self._wait(rest.at_least - rested, self._recorder.take)
        if rest.until:
            until = WaitUntil(condition=rest.until, hold=0.0, timeout=rest.at_most)
            self._wait_until(("run", REST, "until"), until)
        return watch.seconds

    def forget(self) -> None:
        """Empty `recording`, `counts` and `before_abort`: the run may not come about."""
        self.recording = NOTHING_RECORDED
        self.before_abort = ()
        self._streams.begin_run()

    def prepare(self) -> None:
        """Perform the steps before a run; raises what `perform` raises.

        A step may start the publisher of a signal, so that one has to be there only then.
        """
        self.forget()
        # A publisher that was killed and is back counts twice until its lease ends.
        if not self._tuner.wait_until(lambda: not self._recorder.mixed, LONGEST_LEASE):
            raise DisturbedError(self._recorder.mixed)
        self._due = self._all_after
        self._is_prepared = self._is_ready = False
        self._watch.prepare()
        try:
            self._perform(BEFORE)
        except FAULTS:
            # If others publish the same topics, that explains whatever else went wrong.
            self._watch.expect_own_messages()
            raise
        self._watch.expect_own_messages()
        self._streams.check()
        self._tuner.wait_until(lambda: not self._recorder.unpublished, DISCOVERED)
        self._recorder.expect_publishers()
        self._is_prepared = self._is_ready = True

    def perform(self, largest_gaps: Mapping[str, float]) -> None:
        """Perform a run and the steps after it; `recording` has the signals then."""
        self._recorder.expect_publishers()
        self.recording = self._record(largest_gaps)
        if problems := self._cancel():
            raise FailedRunError(problems[0])
        for index in self._due.copy():
            self._perform_after(index)
        self._parameters.give_back()
        if mixed := self._recorder.mixed or self._recorder.mixed_frames:
            raise DisturbedError(mixed)
        self.recording.check(self._study.signals, largest_gaps)
        self._streams.check_follow(self.recording)

    def published(self) -> dict[str, Published]:
        """Return how the messages of each stream came out in the last run."""
        return self._streams.published()

    def played(self) -> dict[str, int]:
        """Return how many messages of a bag were played in the last run, by topic."""
        return {} if self._player is None else dict(self._player.played)

    @property
    def reason_of_abort(self) -> str:
        """Return why the last run was to be aborted, as far as was seen; empty if it was not."""
        return self._watch.reason_of_abort

    @property
    def unpublished(self) -> str:
        """Return a line on a signal that nothing publishes, but should; empty if none.

        Steps of `after` that do more than publish and wait may have ended the publisher, as by the
        cleanup of a lifecycle node. Then it needs to be there only once the next run is prepared.
        """
        acts = any(not (step.publish or step.waits) for step in self._run.after)
        return "" if acts and not self._is_prepared else self._recorder.unpublished

    def request_cancel(self) -> None:
        """End what streams, and ask for the end of goals that are active, not waiting for it."""
        self._streams.stop_all()
        for goal in self._started:
            goal.request_cancel()

    def forget_ended(self, also: Collection[str]) -> None:
        """Forget what was heard from nodes that have ended, and from others, by their names."""
        self._recorder.forget_ended(also, partial(self._tuner.wait_until, timeout=ENDED))

    def welcome(self) -> None:
        """Wait for the first messages of nodes that were started anew, and publish what is due.

        If the steps before a run are done they need not have heard what these have published last.
        """
        self._tuner.wait_until(lambda: not self._recorder.awaits_first, FIRST_MESSAGES)
        if not self._is_ready:
            return
        steps = enumerate(self._run.before)
        last = {step.publish.topic: index for index, step in steps if step.publish is not None}
        for index in sorted(last.values()):
            self._perform_step(("run", BEFORE, index), self._run.before[index])

    def publish_stop(self) -> None:
        """Publish the messages at the head of the steps that are due after a run, if any is.

        They stay due: a node that is started anew next has not heard them.
        """
        self._is_ready = False
        for index in self._head:
            # If nobody hears it, that is reported when it is performed.
            with contextlib.suppress(*FAULTS):
                self._perform_step(("run", AFTER, index), self._run.after[index])

    def leave(self) -> list[str]:
        """Bring a run that did not end well to its end as far as possible: goals, steps after it.

        Each step is performed whether or not the one before it was possible. A message at their
        head, which stops the machine, does not wait until a goal has ended. What was not possible
        for want of a node is performed by the next call.
        """
        self.request_cancel()
        first = self._head
        problems = self._leave_by(first)
        problems += self._cancel()
        # What nobody has heard just now waits for the next call.
        problems += self._leave_by([index for index in self._due if index not in first])
        return problems + self._give_back()

    def recover(self) -> list[str]:
        """Perform the steps that bring the machine home; returns what went wrong, in lines.

        If one is not possible, `leave` the machine as after a run. While a goal has not ended
        nothing is performed.
        """
        if unended := [goal.unended for goal in self._started if goal.is_open]:
            return [f"not recovered: {problem}" for problem in unended]
        missed, self._due = self._due, self._all_after
        self._streams.begin_run()
        try:
            self._perform(RECOVER)
            self._streams.check()
        except FAULTS as fault:
            return [f"not recovered: {fault}"]
        finally:
            self._streams.stop_all()
        self._due = missed
        return self._give_back()

    def _give_back(self) -> list[str]:
        """Let nodes have again what steps have changed; returns what went wrong."""
        try:
            self._parameters.give_back()
        except FAULTS as fault:
            return [f"not given back what steps have set: {fault}"]
        return []

    def close(self) -> None:
        """Hear no more, once what was published has been received."""
        self._streams.stop_all()
        for topic in self._topics.values():
            topic.publisher.wait_for_all_acked(Duration(seconds=ACKNOWLEDGED))
        for goal in self._goals.values():
            goal.close()
        if self._player is not None:
            self._player.close()
        self._recorder.close()

    def _record(self, largest_gaps: Mapping[str, float]) -> Recording:
        self._is_ready = False
        self._clock.begin()
        self._recorder.begin()
        self._streams.begin_run()
        self._watch.begin(largest_gaps)
        self._is_recording = True
        guarded = contextlib.nullcontext() if self._guard is None else self._guard.run()
        try:
            with guarded:
                self._perform(START)
                return self._recorder.recording(self._watch.wait_for_end())
        except FailedRunError:
            if self.reason_of_abort:
                self.before_abort = self._latest_messages.now()
            raise
        except GuardActedError:
            # It may only have been quicker.
            with contextlib.suppress(FailedRunError):
                self._watch.look_for_abort(self._recorder.seconds, self._recorder.seconds)
            self.before_abort = self._latest_messages.now()
            raise
        except LostError:
            # Of values that are not finite a node dies, whichever was noticed first.
            self._recorder.recording(self._recorder.seconds).check_finite(self._study.signals)
            raise
        finally:
            self._is_recording = False
            self._streams.stop_all()
            if self._player is not None:
                self._player.stop()
            self._recorder.end()
            self._clock.end()
            self._since_run = Stopwatch(self._clock)

    @property
    def _head(self) -> list[int]:
        """The steps that are due after a run, as far as the first ones are messages."""
        return list(takewhile(lambda i: self._run.after[i].publish is not None, self._due))

    @property
    def _all_after(self) -> list[int]:
        return list(range(len(self._run.after)))

    def _perform_after(self, index: int) -> None:
        """Perform a step of `after`; it stays due if an interruption or a lost node ends it.

        So does a message that nobody hears: who is to hear it may be back before the end.
        """
        self._is_prepared = False
        try:
            self._perform_step(("run", AFTER, index), self._run.after[index])
        except (SilentError, UnheardError):
            # The others do not wait for this node once more.
            self._due.remove(index)
            self._due.append(index)
            raise
        except OWN_FAULTS:
            self._due.remove(index)
            raise
        self._due.remove(index)

    def _leave_by(self, indices: list[int]) -> list[str]:
        """Perform steps of `after`; returns what went wrong."""
        problems = []
        for index in indices:
            try:
                self._perform_after(index)
            except FAULTS as fault:
                problems.append(f"{dotted(('run', AFTER, index))}: {fault}")
        return problems

    def _perform(self, phase: str) -> None:
        for index, step in enumerate(getattr(self._run, phase)):
            # A step may act before it waits: the end may have been asked for since the last wait.
            self._tuner.look()
            if self._is_recording and not step.waits:
                self._expect_time(index)
            self._perform_step(("run", phase, index), step)
            if self._is_recording and (step.publish is not None or step.send_goal is not None):
                # It may have had to wait for a subscriber, or for the answer of a server.
                self._expect_time(index)

    def _expect_time(self, index: int) -> None:
        """Raise `FailedRunError` if a run is over before it has performed a step of `start`.

        The effect of the step would not be recorded. A study may have a step wait until the end of
        the run on purpose.
        """
        after, planned = self._run.end.after, sum(s.wait or 0.0 for s in self._run.start[:index])
        # Waits that add up to it may lack a rounding error.
        if after is not None and planned < after - 1e-9 and after < self._recorder.seconds:
            raise FailedRunError(
                f"{dotted(('run', START, index))} comes after the end of the run at {after:g} s"
            )

    def _perform_step(self, path: KeyPath, step: Step) -> None:
        # A service may have taken its time, and the search between two runs: waiting counts from
        # now, and what is published has the time of now.
        self._clock.update()
        if step.wait is not None:
            self._wait(step.wait, self._poll(path))
        elif step.wait_until is not None:
            self._wait_until(path, step.wait_until)
        elif step.restart and self._restart is not None:
            self._restart(step.restarts)
        elif step.stop:
            self._streams.release(self._tuner.node.resolve_topic_name(step.stop))
        else:
            judged = self._tuner.also_watched_by(self._watch.judge)
            with judged if self._is_recording else contextlib.nullcontext():
                if path in self._goals:
                    self._send(self._goals[path])
                elif path in self._prepared_streams:
                    self._stream(path, self._prepared_streams[path])
                elif step.play is not None and self._player is not None:
                    self._player.begin()
                else:
                    if step.publish is not None:
                        name = self._tuner.node.resolve_topic_name(step.publish.topic)
                        self._streams.release(name)
                    self._steps[path].perform()

    def _stream(self, path: KeyPath, stream: Stream) -> None:
        if path[1] == AFTER:
            self._streams.perform(stream, self._recorder.take)
        else:
            self._streams.begin(stream)

    def _send(self, goal: Goal) -> None:
        if goal not in self._started:
            self._started.append(goal)
        goal.send()
        if not self._is_recording:
            goal.wait()

    def _poll(self, path: KeyPath) -> Callable[[], object]:
        """Return what takes messages in a step; none can cut the way to rest, or a rest, short."""
        return self._recorder.take if path[1] in (AFTER, REST) else self._recorder.poll

    def _wait(self, period: float, poll: Callable[[], object]) -> None:
        if self._is_recording:
            self._watch.wait(period)
            return
        watch = Stopwatch(self._clock)
        while (left := period - watch.seconds) > 0.0:
            poll()
            self._clock.look()
            self._tuner.spin_once(min(POLL_PERIOD, left))

    def _wait_until(self, path: KeyPath, wait: WaitUntil) -> None:
        text = filled_condition(wait.condition, self._values(path))
        condition = expression(text, self._study.signals)
        used = {name: self._study.signals[name] for name in condition.names - {TIME}}
        if not self._is_recording:
            self._recorder.begin(in_run=False)
        began = looked = self._recorder.seconds
        watch = Stopwatch(self._clock)
        edge = Edge(wait.hold)

        def held() -> bool:
            """Whether it has held all the time since `hold` seconds ago, or has come to."""
            nonlocal looked
            if not self._is_recording and self._recorder.clock_was_set:
                self._recorder.begin(in_run=False)
            now = self._recorder.seconds
            since = max(looked - OVERLAP, began) if wait.rising else now - wait.hold
            if since < began:
                return False
            recording = self._recorder.recording(now, since)
            if any(recording.silence(name, spec) for name, spec in used.items()):
                return False
            times, values = sampled(condition, recording, since)
            if wait.rising:
                looked = now
                return edge.look(times, values)
            # Of a signal without an earlier message nothing is known before its first one.
            is_whole = len(times) > 0 and times[0] <= since
            return is_whole and bool(np.all(np.nan_to_num(values) != 0.0))

        if self._is_recording:
            self._watch.wait_until(began + wait.timeout, held)
            holds = held()
        else:
            poll = self._poll(path)
            while not (holds := held()) and watch.seconds <= wait.timeout:
                self._tuner.spin_once(POLL_PERIOD)
                self._clock.look()
                poll()
        if not holds:
            if unpublished := self._recorder.unpublished_of(used):
                raise LostError(unpublished)
            recording = self._recorder.recording(self._recorder.seconds)
            dead = any(recording.silence(name, spec) for name, spec in used.items())
            advice = f"; {self._advice}" if path[1] == BEFORE and not dead else ""
            how = f"does not hold for {wait.hold:g} s" if wait.hold else "does not hold"
            if wait.rising:
                how = "does not come to hold" + ("" if edge.was_off else ", as it never ceased to")
            raise FailedRunError(
                f"{dotted(path)}: {checks.quoted(text)} {how} within {wait.timeout:g} s"
                f"{latest(used, recording)}{advice}"
            )

    @property
    def _advice(self) -> str:
        return NOT_SETTLED if self._study.park.between_runs else TOO_SLOW

    def _cancel(self) -> list[str]:
        """Cancel the goals that are active; returns what went wrong."""
        self.request_cancel()
        return [problem for goal in self._started if (problem := goal.cancel())]

    def _values(self, path: KeyPath = ()) -> dict[str, Value]:
        """Return the values for names in braces in a step: after a run the safe ones."""
        is_over = bool({AFTER, RECOVER} & set(path[1:2]))
        return {**(self._safe if is_over else self._parameters_of_run), **self._context}

    def _fill(self) -> None:
        """Give the prepared steps the present values."""
        for path, step in self._run.steps:
            if not varies(step):
                continue
            filled = filled_step(step, self._values(path))
            with under(*path):
                if path in self._steps:
                    self._steps[path] = self._steps[path].filled(filled)
                elif path in self._prepared_streams:
                    self._prepared_streams[path] = self._prepared_streams[path].filled(filled)
                elif path in self._goals and filled.send_goal is not None:
                    with under("send_goal"):
                        self._goals[path].fill(filled.send_goal)
                elif filled.play is not None and self._player is not None:
                    with under("play"):
                        self._player.fill(filled.play)

    def _connect(self) -> None:
        wait = partial(self._tuner.wait_until, timeout=CONNECT_TIMEOUT)
        ticks: Ticks = WallTicks(self._clock)
        if self._run.clock == SIM and self._run.play is None:
            clock = SimClock(self._recorder.node)
            with under("run", "clock"):
                clock.connect(wait)
                self._clock = clock
                ticks = SimTicks(self._recorder.node)
                ticks.connect(wait)
        preparation = Preparation(
            self._study,
            self._tuner,
            self._clock,
            attached=self._restart is None,
            listener=self._recorder.node,
            ticks=ticks,
            parameters=self._parameters,
        )
        self._topics = preparation.topics
        if self._run.play is not None:
            self._clock = preparation.play_clock()
        for path, step in self._run.steps:
            prepared = preparation.prepare(path, filled_step(step, self._values(path)))
            if isinstance(prepared, Goal):
                self._goals[path] = prepared
            elif isinstance(prepared, Stream):
                self._prepared_streams[path] = prepared
            elif isinstance(prepared, Player):
                self._player = prepared
            elif prepared is not None:
                self._steps[path] = prepared
        # That a field cannot hold a value shows at the ends of contexts and parameters.
        space, sets = self._study.context_space(), self._study.search_space()
        nominal = self._context
        for row in space.to_contexts(space.corners()):
            self._context = space.to_dict(row)
            self._fill()
        self._context = nominal
        for share in (0.0, 1.0):
            point = np.full(sets.dimension, share)
            self._parameters_of_run = {**self._safe, **sets.to_parameters(point)}
            self._fill()
        self._parameters_of_run = self._safe
        self._fill()
        self._recorder.connect(self._clock, wait)
        for node in self._recorder.publishers:
            # One that is none of the study's need not answer.
            with contextlib.suppress(LostError):
                meet(self._tuner, node, time.monotonic() + CONNECT_TIMEOUT)
