"""The guard's process: its ROS node, and what it does when it acts."""

import contextlib
import os
import signal
import time
import uuid
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from functools import partial
from pathlib import Path
from typing import Any, Protocol

from action_msgs.srv import CancelGoal
from rclpy.client import Client
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.publisher import Publisher
from std_msgs.msg import String

from bo_tuner.backends.ros import others
from bo_tuner.backends.ros.clock import RunClock, SimClock, Stopwatch, WallClock
from bo_tuner.backends.ros.errors import LostError, RefusedError
from bo_tuner.backends.ros.guard.condition import AbortCondition
from bo_tuner.backends.ros.guard.messages import (
    BEAT_TOPIC,
    BEATS,
    GUARD,
    LATEST,
    PERIOD,
    STATE_TOPIC,
    Beat,
    State,
)
from bo_tuner.backends.ros.guard.plan import GIVE_UP, Patience, Plan
from bo_tuner.backends.ros.guard.watch import Cause, Watch
from bo_tuner.backends.ros.lifecycle import ACTIVE
from bo_tuner.backends.ros.own_topics import OwnTopic
from bo_tuner.backends.ros.parameters.nodes import NodeParameters
from bo_tuner.backends.ros.publication import Publication
from bo_tuner.backends.ros.reconfiguration import Reconfiguration, reconfiguration_of
from bo_tuner.backends.ros.tuner_node import POLL_PERIOD, TunerNode
from bo_tuner.codec.findings import under
from bo_tuner.errors import BackendError, StudyError
from bo_tuner.storage.guard_record import Act, add_act
from bo_tuner.study.run import SIM
from bo_tuner.text import listed

LOOK_AROUND = 0.5
"""Time [s] to hear of another guard."""
CONNECT = 10.0
"""Time [s] to find the nodes."""
ANSWER = 2.0
"""Time [s] that all nodes have to take the safe values."""
AGAIN = 0.5
"""Time [s] after which what the nodes have is checked again while they are held safe."""
GONE = 3.0
"""Time [s] for which a guard tries to leave nodes safe that end with their tuner."""
ACKNOWLEDGED = 1
"""Time [s] for the tuner to hear of the last act."""
ASLEEP = 0.3
"""Gap [s] between two cycles beyond which this process did not run."""


class Beats(Protocol):
    """How heartbeats come in."""

    def take(self) -> tuple[list[Beat], bool]:
        """Return those that came since the last call, and whether no more can come."""


class PipeBeats:
    """Heartbeats on a pipe, which closes at the moment at which the tuner's process ends."""

    def __init__(self, descriptor: int) -> None:
        self._descriptor = descriptor
        self._rest = b""
        os.set_blocking(descriptor, False)

    def take(self) -> tuple[list[Beat], bool]:
        """Return those that came since the last call, and whether no more can come."""
        ended = False
        while True:
            try:
                data = os.read(self._descriptor, 65536)
            except BlockingIOError:
                break
            if not data:
                ended = True
                break
            self._rest += data
        *lines, self._rest = self._rest.split(b"\n")
        return [beat for line in lines if (beat := Beat.read(line)) is not None], ended


class TopicBeats:
    """Heartbeats of a tuner on another machine."""

    def __init__(self) -> None:
        self._beats: list[Beat] = []

    def connect(self, tuner: TunerNode, name: str) -> None:
        """Listen for those to the guard of a name."""

        def hear(message: Any) -> None:
            beat = Beat.read(message.data)
            if beat is not None and beat.guard == name:
                self._beats.append(beat)

        tuner.node.create_subscription(String, BEAT_TOPIC, hear, BEATS)

    def take(self) -> tuple[list[Beat], bool]:
        """Return those that came since the last call; more can always come."""
        beats, self._beats = self._beats, []
        return beats, False


class Guard:
    """Guards the nodes of a plan."""

    def __init__(
        self,
        plan: Plan,
        ros_arguments: Sequence[str],
        beats: Beats,
        *,
        name: str = "",
        patience: Patience,
        attached: bool,
        record: Path | None,
        say: Callable[[str], None],
    ) -> None:
        self._plan = plan
        self._beats = beats
        self._name = name or uuid.uuid4().hex
        self._record = record
        self._output = say
        self._attached = attached
        self._watch = Watch(patience)
        self._ending = False
        self._held = 0.0
        # It publishes its state also while it waits for a node: its tuner awaits it.
        self._tuner = TunerNode(None, ros_arguments, self._publish_state_if_due, GUARD)
        self._state = State(
            self._name,
            plan.digest,
            plan.name,
            tuple(plan.full_names(self._tuner.node.get_namespace())),
            tuple(sorted({self._tuner.node.resolve_topic_name(item.topic) for item in plan.stop})),
            stands=isinstance(beats, TopicBeats),
        )
        self._listener: Node | None = None
        self._publisher: Publisher | None = None
        self._published = -1.0
        self._was_in_run = False
        self._ways: dict[str, tuple[Reconfiguration | None, str]] = {}

    @property
    def nodes(self) -> tuple[str, ...]:
        """Full names of the nodes that it guards."""
        return self._state.nodes

    def open(self, *, wait: bool, alone: bool = True) -> None:
        """Find the nodes and who hears the stop messages."""
        tuner, plan = self._tuner, self._plan
        if isinstance(self._beats, TopicBeats):
            self._beats.connect(tuner, self._name)
        self._publisher = tuner.node.create_publisher(String, STATE_TOPIC, LATEST)
        if alone:
            self._refuse_others()
        self._state = replace(self._state, settled=True)
        self._publish_state()
        self._parameters = NodeParameters(tuner, plan.nodes, plan.safe)
        clients = self._parameters.clients

        def absent() -> list[str]:
            return [client.node for client in clients.values() if not client.is_ready()]

        while not tuner.wait_until(lambda: not absent() or self._ending, CONNECT):
            problem = others.absent(absent(), tuner.node)
            if not wait:
                raise BackendError(problem)
            self._say(f"waiting: {problem}")
        for key in plan.nodes:
            # How a node is to be asked must be known when it is to be left safe.
            with contextlib.suppress(LostError):
                self._parameters.read_anew(key)
        for remark in self._parameters.take_remarks():
            self._say(remark)
        self._ways = {key: self._way(key) for key in plan.configured}
        # In no executor, which would take its messages away.
        self._listener = listener = Node(
            f"{GUARD}_listener",
            context=tuner.context,
            enable_rosout=False,
            start_parameter_services=False,
        )
        self._clock = self._connect_clock(listener)
        self._in_run = Stopwatch(self._clock)
        topics: dict[str, OwnTopic] = {}
        with under("publish"):
            self._stop = [
                Publication.prepare(tuner, item, self._clock, topics, None, is_stop=True)
                for item in plan.stop
            ]
        self._cancels: list[Client] = [
            tuner.node.create_client(CancelGoal, f"{action}/_action/cancel_goal")
            for action in plan.actions
        ]
        self._abort = AbortCondition(listener, plan)

    def serve(self) -> None:
        """Guard until the tuner has ended and the nodes are safe, or the end is asked for."""
        looked = time.monotonic()
        seen = 0.0
        while True:
            beats, hung_up = self._beats.take()
            now = time.monotonic()
            if now - looked > ASLEEP:
                self._watch.wake(now)
            looked = now
            for beat in beats:
                self._watch.beat(beat, now)
            if hung_up:
                self._watch.hang_up()
            self._look_at_signals(now)
            cause = self._watch.due(now)
            if cause is None and self._ending and self._watch.is_watching:
                cause = Cause("the guard was asked to end")
            if cause is not None:
                self._act(cause, hung_up or self._ending)
                looked = time.monotonic()
            elif not self._watch.is_known:
                self._hold()
            if hung_up or self._ending:
                return
            if now - seen >= PERIOD:
                self._look_at_nodes()
                seen = now
            self._tuner.spin_once(POLL_PERIOD)

    def end(self) -> None:
        """Ask for the end, as by a signal: nodes in a tuner's hands are left safe first."""
        self._ending = True

    def close(self) -> None:
        """Leave ROS, once the tuner has heard what came of the last act."""
        if self._publisher is not None:
            self._publisher.wait_for_all_acked(Duration(seconds=ACKNOWLEDGED))
        if self._listener is not None:
            self._listener.destroy_node()
        self._tuner.close()

    def _refuse_others(self) -> None:
        """Refuse nodes that another guard has; if its tuner has just ended, its end is awaited.

        Of two that start at the same time one stays.
        """
        rivals: dict[str, State] = {}

        def hear(message: Any) -> None:
            state = State.read(message.data)
            if state is None or not set(state.nodes) & set(self._state.nodes):
                return
            if state.guard != self._name and (state.settled or state.guard < self._name):
                rivals[state.guard] = state

        subscription = self._tuner.node.create_subscription(String, STATE_TOPIC, hear, LATEST)
        deadline = time.monotonic() + CONNECT
        while True:
            rivals.clear()
            self._tuner.spin_for(LOOK_AROUND)
            stand = any(state.stands for state in rivals.values())
            if not rivals or stand or time.monotonic() > deadline:
                break
        self._tuner.node.destroy_subscription(subscription)
        for state in rivals.values():
            shared = sorted(set(state.nodes) & set(self._state.nodes))
            raise BackendError(
                f"{shared[0]} has a guard already, of study {state.study}; end that one first"
            )

    def _look_at_nodes(self) -> None:
        for client in self._parameters.clients.values() if self._attached else ():
            self._watch.presence(client.node, client.is_ready())

    def _connect_clock(self, listener: Node) -> RunClock:
        """Return the clock of the runs; one of a simulation is waited for."""
        if self._plan.clock != SIM:
            return WallClock()
        clock = SimClock(listener)
        with under("run", "clock"):
            clock.connect(partial(self._tuner.wait_until, timeout=CONNECT))
        return clock

    def _look_at_signals(self, now: float) -> None:
        in_run = self._watch.in_run
        if not in_run:
            # Between two runs it may be set, and need not be remembered.
            self._clock.begin()
            self._clock.end()
        self._clock.update()
        if in_run and not self._was_in_run:
            self._in_run = Stopwatch(self._clock)
        # What came between two runs is taken, and does not count.
        if self._abort.holds(self._in_run.seconds) and in_run and self._was_in_run:
            self._watch.held(now)
        self._was_in_run = in_run

    def _act(self, cause: Cause, is_last: bool) -> None:
        """Stop the machine, then set the safe values; again and again if nobody else will."""
        begun = time.monotonic()
        self._watch.act()
        self._publish_stop()
        stopped = time.monotonic() - begun
        self._state = replace(
            self._state,
            acts=self._watch.acts,
            reason=cause.reason,
            outcome="",
            takes_over=cause.takes_over,
            on_condition=cause.on_condition,
            ends=is_last,
        )
        self._publish_state()
        self._say(f"acts: {cause.reason}")
        problems = self._set_safe() or self._configure_anew()
        patience = GIVE_UP if self._attached else GONE
        while problems and is_last and time.monotonic() - begun < patience:
            self._say("; ".join(problems))
            self._tuner.spin_for(AGAIN)
            self._publish_stop()
            problems = self._set_safe() or self._configure_anew()
        # A node may have got a command of the tuner's in between.
        self._publish_stop()
        safe = time.monotonic() - begun
        outcome = f"stop messages after {stopped * 1e3:.1f} ms, "
        outcome += (
            "; ".join(problems)
            if problems
            else f"safe values set and read back after {safe * 1e3:.0f} ms{self._in_force}"
        )
        self._state = replace(self._state, outcome=outcome)
        self._publish_state()
        self._say(outcome)
        self._note(cause.reason, stopped, safe, problems)
        self._held = time.monotonic()

    def _hold(self) -> None:
        """Check what the nodes have again: a tuner that lives again may be setting others."""
        if time.monotonic() - self._held < AGAIN:
            return
        self._set_safe()
        self._held = time.monotonic()

    def _publish_stop(self) -> None:
        self._clock.update()
        for publication in self._stop:
            publication.publish_now()
        # Without an identifier and a time stamp it is for all goals (action_msgs/srv/CancelGoal).
        for client in self._cancels:
            client.call_async(CancelGoal.Request())

    def _set_safe(self) -> list[str]:
        """Set the safe values and read them back; returns what went wrong, in lines."""
        self._parameters.forget_all()
        failed = self._parameters.assign_side_by_side(self._plan.safe, ANSWER)
        return [f"{self._plan.nodes[key]} is not safe: {why}" for key, why in failed.items()]

    @property
    def _in_force(self) -> str:
        """Say which nodes were configured anew, without which the values would do nothing."""
        names = [self._plan.nodes[key] for key in self._plan.configured]
        return f", and in force: {listed(names)} configured anew" if names else ""

    def _configure_anew(self) -> list[str]:
        """Let nodes take the safe values that act only so; returns what went wrong, in lines."""
        problems = []
        for key, name in ((key, self._plan.nodes[key]) for key in self._plan.configured):
            try:
                way, state = self._ways[key]
                if way is None:
                    way, state = self._ways[key] = self._way(key)
                if way is None:
                    problems.append(f"{name} is not safe: nothing configures it")
                    continue
                # Its tuner may have ended while it was unconfigured.
                way.configure_anew(ACTIVE if state == ACTIVE else "")
            except (LostError, RefusedError, StudyError) as error:
                problems.append(f"{name} is not safe: {error}")
        return problems

    def _way(self, key: str) -> tuple[Reconfiguration | None, str]:
        """Return how a node is configured, if known, and the state in which it is now."""
        with contextlib.suppress(LostError):
            if way := reconfiguration_of(self._tuner, self._plan.configured[key]):
                return way, way.state
        return None, ""

    def _publish_state(self) -> None:
        if self._publisher is None:
            return
        watches = self._watch.is_watching and self._watch.is_known
        self._publisher.publish(String(data=str(replace(self._state, watches=watches))))
        self._published = time.monotonic()

    def _publish_state_if_due(self) -> None:
        if time.monotonic() - self._published >= PERIOD:
            self._publish_state()

    def _say(self, text: str) -> None:
        """Say something; a full disk, or a terminal that is gone, keeps it from nothing."""
        # Of a pipe that is closed rich makes an exit.
        with contextlib.suppress(OSError, SystemExit):
            self._output(text)

    def _note(self, reason: str, stopped: float, safe: float, problems: Iterable[str]) -> None:
        """Add a line to the record, which must not keep it from anything."""
        if self._record is None:
            return
        begun = datetime.now(UTC) - timedelta(seconds=safe)
        time_of_act = begun.isoformat(timespec="milliseconds")
        act = Act(time_of_act, reason, round(stopped, 4), round(safe, 4), tuple(problems))
        with contextlib.suppress(OSError):
            add_act(self._record, act)


def end_on_signals(guard: Guard, *, by_hand: bool = False) -> None:
    """Let SIGTERM end the guard, and Ctrl-C one that was started by hand.

    What a terminal sends to a tuner is for the tuner alone, which then ends its guard.
    """
    for signum in (signal.SIGHUP, signal.SIGQUIT, signal.SIGTSTP):
        signal.signal(signum, signal.SIG_IGN)
    signal.signal(signal.SIGINT, (lambda *_: guard.end()) if by_hand else signal.SIG_IGN)
    signal.signal(signal.SIGTERM, lambda *_: guard.end())
