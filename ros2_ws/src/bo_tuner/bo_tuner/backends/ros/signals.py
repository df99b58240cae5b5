"""Hears the signals of a study, each from the one node that publishes it."""

import time
from bisect import bisect_right
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from rclpy.context import Context
from rclpy.node import Node
from rclpy.qos import QoSDurabilityPolicy, QoSProfile, QoSReliabilityPolicy
from rclpy.subscription import Subscription
from rclpy.topic_endpoint_info import TopicEndpointInfo

from bo_tuner.backends.ros import others
from bo_tuner.backends.ros.clock import LARGEST_JUMP, RunClock, Stopwatch, WallClock
from bo_tuner.backends.ros.decoding import UnreadableError, decode
from bo_tuner.backends.ros.errors import LostError
from bo_tuner.backends.ros.guard.messages import GUARD
from bo_tuner.backends.ros.lost_messages import LostMessages
from bo_tuner.backends.ros.messages import (
    ItemMissingError,
    has_header,
    interface_class,
    number_reader,
)
from bo_tuner.backends.ros.tuner_node import NODE_NAME as TUNER
from bo_tuner.backends.ros.tuner_node import UNKNOWN_NODE, full_name
from bo_tuner.errors import StudyError
from bo_tuner.metrics.recording import FailedRunError, RecordedSignal, Recording
from bo_tuner.numerics.arrays import Array
from bo_tuner.study.building import under
from bo_tuner.study.signals import HEADER, RECEPTION, Signal, field_path

NODE_NAME = f"{TUNER}_signals"
DEPTH = 5000
"""Messages of a topic that may wait between two looks at it: 5 s at 1 kHz."""
RECENT = 1_000_000_000
"""Time [ns] ahead of a run in which a topic has a message that is not only published in runs."""
LISTEN = 1.0
"""Time [s] to hear a message, which tells the names of items."""


class SignalRecorder:
    """Records the signals of a run, and tells how they are while it lasts.

    Messages wait in the middleware, which notes when they came in, until `poll` takes them; none
    of them wakes up the tuner.

    Parameters
    ----------
    context
        ROS context of the tuner.
    signals
        The study's signals.
    guarded
        Topics that a guard would publish: its silent publisher does not count.

    Attributes
    ----------
    node : Node
        The recorder's node, which is in no executor.
    """

    def __init__(
        self, context: Context, signals: Mapping[str, Signal], guarded: Collection[str] = ()
    ) -> None:
        self._signals = signals
        self._guarded = guarded
        self._clock: RunClock = WallClock()
        self.node = Node(
            NODE_NAME, context=context, enable_rosout=False, start_parameter_services=False
        )
        self._heard: dict[str, _Topic] = {}
        self._began = 0
        self._watch = Stopwatch(self._clock)

    def connect(self, clock: RunClock, wait: Callable[[Callable[[], bool]], bool]) -> None:
        """Subscribe to every signal.

        Parameters
        ----------
        clock
            Tells the time of the runs, which is also that of headers.
        wait
            Waits until a condition holds; whether it did in time.

        Raises
        ------
        StudyError
            If a topic has no publisher, or two, or other messages than expected, also in that
            they name the items of an array, and not the one of the signal.
        """
        self._clock = clock
        for name, spec in self._signals.items():
            with under("signals", name):
                self._connect(name, spec, wait)
        # What is published before a subscription is known to the publisher is lost.
        wait(lambda: all(heard.publishers for heard in self._heard.values()))
        # So that also what is published only now and then has a value when a run starts.
        latched = [heard for heard in self._heard.values() if heard.is_latched]
        wait(lambda: all(heard.has_message() for heard in latched))
        self._refuse_unknown_items(wait)

    @property
    def publishers(self) -> set[str]:
        """Full names of the nodes that publish the signals, as far as the graph tells."""
        return {
            full_name(info.node_namespace, info.node_name)
            for topic in self._heard
            for info in self.node.get_publishers_info_by_topic(topic)
            if info.node_name != UNKNOWN_NODE
        }

    @property
    def mixed(self) -> str:
        """Tell in a line of a topic that more than one node publishes; empty if none."""
        for heard in self._heard.values():
            if heard.publishers > 1:
                return f"{heard.name} has {heard.publishers} publishers, whose messages mix"
        return ""

    @property
    def unpublished(self) -> str:
        """Tell in a line of a topic that nobody publishes any more; empty if none."""
        return self.unpublished_of(self._signals)

    def unpublished_of(self, names: Iterable[str]) -> str:
        """Tell as `unpublished`, of the topics of some signals."""
        wanted = set(names)
        for heard in self._heard.values():
            if heard.publishers == 0 and not wanted.isdisjoint(heard.tracks):
                of = f", which was {heard.node}" if heard.node != UNKNOWN_NODE else ""
                return f"{heard.name} has no publisher any more{of}"
        return ""

    def expect_publishers(self) -> None:
        """Raise `LostError` if nothing publishes a signal any more."""
        if unpublished := self.unpublished:
            raise LostError(unpublished)

    @property
    def stale(self) -> str:
        """Tell in a line of a signal whose messages are all late for too long; empty if none.

        Those that are reordered are late one by one. Several in a row, by long, come after a stamp
        that was wrong, or of a clock that was set or stands still.
        """
        for name, spec in self._signals.items():
            stale = self._track(name).stale * 1e-9
            if stale > LARGEST_JUMP:
                return (
                    f"the stamps of signal {name} ({spec.topic}) stand still or go back, "
                    f"for {stale:.3g} s"
                )
        return ""

    def begin(self, in_run: bool = True) -> None:
        """Count time from now on, and of what came before only the latest.

        In a run a message whose stamp is not after that of the one before is late; otherwise what
        comes last holds, as a simulation may be reset.
        """
        for heard in self._heard.values():
            heard.poll()
        self._began = self._clock.now
        self._watch = Stopwatch(self._clock)
        for heard in self._heard.values():
            heard.begin(self._began, in_run)

    def forget_ended(
        self, also: Collection[str], wait: Callable[[Callable[[], bool]], bool]
    ) -> None:
        """Forget what was said by publishers that are gone: it holds for no run of the next ones.

        Parameters
        ----------
        also
            Names of nodes that are there, and of which it does not hold either.
        wait
            As of `connect`; that of a node which has ended may be gone a moment after it.
        """
        names = {UNKNOWN_NODE} | {name for name, _ in self.node.get_node_names_and_namespaces()}
        ended = [h for h in self._heard.values() if h.node not in names or not h.publishers]
        wait(lambda: all(heard.publishers == 0 for heard in ended))
        for heard in self._heard.values():
            if heard.publishers == 0 or heard.node in also:
                heard.forget()

    @property
    def awaits_first(self) -> bool:
        """Whether a topic that was published ahead of the last run, too, has no message yet."""
        before = [heard for heard in self._heard.values() if heard.is_continuous]
        return not all(heard.has_message() for heard in before)

    def end(self) -> None:
        """End a run."""
        for heard in self._heard.values():
            for track in heard.tracks.values():
                track.in_run = False

    @property
    def seconds(self) -> float:
        """Time since the start of the run [s]."""
        return (self._clock.now - self._began) * 1e-9

    @property
    def clock_was_set(self) -> bool:
        """Whether the clock was set since then, so that `seconds` have not passed."""
        return abs(self.seconds - self._watch.seconds) > LARGEST_JUMP

    @property
    def latest(self) -> float:
        """Latest time [s] since the start of the run that a message is stamped with.

        It may lie ahead, by as much as the clock of another machine is ahead of this one's.
        """
        stamps = [
            track.stamps[-1]
            for heard in self._heard.values()
            for track in heard.tracks.values()
            if track.stamps
        ]
        return (max(stamps, default=self._began) - self._began) * 1e-9

    def poll(self) -> None:
        """Take what came in.

        Raises
        ------
        FailedRunError
            If a message does not have the item of an array that a signal is.
        """
        if problem := self.take():
            raise FailedRunError(problem)

    def take(self) -> str:
        """Take what came in; returns in a line what `poll` would raise, or an empty one."""
        problems = []
        for heard in self._heard.values():
            heard.poll()
            problems.append(heard.problem)
            heard.problem = ""
        return next(filter(None, problems), "")

    def take_late(self) -> Iterator[dict[str, Array]]:
        """Yield the late messages of a topic that came since the last call, and what came last.

        Values (n,) of its signals by their names, and beside them the newest of the others, ().
        """
        newest = {name: np.array(self._track(name).newest) for name in self._signals}
        for heard in self._heard.values():
            late = {name: track.take_late() for name, track in heard.tracks.items()}
            if any(map(len, late.values())):
                yield newest | {name: values for name, values in late.items() if len(values)}

    def recording(self, end: float, since: float = -np.inf) -> Recording:
        """Return what was recorded until `end` [s], from the last message before `since` [s] on."""
        latest = self._began + round(end * 1e9)
        signals = {}
        for name, spec in self._signals.items():
            heard = self._heard[self.node.resolve_topic_name(spec.topic)]
            track = heard.tracks[name]
            first = 0
            if since > -np.inf:
                first = max(bisect_right(track.stamps, self._began + round(since * 1e9)) - 1, 0)
            last = bisect_right(track.stamps, latest)
            # Of those before the start the last one holds there.
            first = max(first, bisect_right(track.stamps, self._began - 1) - 1)
            stamps = np.array(track.stamps[first:last], dtype=np.int64) - self._began
            signals[name] = RecordedSignal(
                (stamps * 1e-9).astype(np.float64),
                np.array(track.values[first:last]),
                heard.lost.count,
                track.late,
                track.offset * 1e-9,
            )
        return Recording(signals, end)

    def close(self) -> None:
        """Hear no more."""
        self.node.destroy_node()

    def _track(self, name: str) -> "_Track":
        return self._heard[self.node.resolve_topic_name(self._signals[name].topic)].tracks[name]

    def _connect(self, name: str, spec: Signal, wait: Callable[[Callable[[], bool]], bool]) -> None:
        topic = self.node.resolve_topic_name(spec.topic)
        publishers = self.node.get_publishers_info_by_topic

        def present() -> list[TopicEndpointInfo]:
            return [info for info in publishers(topic) if info.node_name != GUARD]

        if not wait(lambda: bool(present())):
            near = others.instead(topic, others.topics(self.node), self.node)
            raise StudyError(f"nothing publishes {topic}; {near}", ("topic",))
        found = present()
        if len(found) > 1:
            nodes = " and ".join(sorted(i.node_name for i in found if i.node_name != UNKNOWN_NODE))
            raise StudyError(
                f"{topic} has {len(found)} publishers ({nodes}), whose messages would mix",
                ("topic",),
            )
        (publisher,) = found
        if spec.type not in ("", publisher.topic_type):
            raise StudyError(
                f"{topic} carries {publisher.topic_type}, expected {spec.type}", ("type",)
            )
        with under("topic"):
            cls = interface_class(publisher.topic_type)
        if spec.time == HEADER and not has_header(cls):
            raise StudyError(
                f"{publisher.topic_type} has no header; expected {RECEPTION}", ("time",)
            )
        try:
            read = number_reader(cls, field_path(spec.field))
        except StudyError as error:
            raise StudyError(error.problem, ("field",)) from None
        if topic not in self._heard:
            subscribed = self._subscribe(topic, cls, publisher.qos_profile)
            of_guard = int(topic in self._guarded)
            self._heard[topic] = _Topic(
                topic, publisher.node_name, self._clock, *subscribed, of_guard
            )
        by_header = spec.time == HEADER or (spec.time == "" and has_header(cls))
        self._heard[topic].tracks[name] = _Track(read, by_header, self._clock)

    def _refuse_unknown_items(self, wait: Callable[[Callable[[], bool]], bool]) -> None:
        """Refuse an item by a name that messages do not have; a silent topic may have it later."""
        named = [
            (name, self._heard[self.node.resolve_topic_name(spec.topic)])
            for name, spec in self._signals.items()
            if any(isinstance(part.item, str) for part in field_path(spec.field))
        ]
        deadline = time.monotonic() + LISTEN

        def all_heard() -> bool:
            for _, heard in named:
                heard.poll()
            return all(heard.tracks[name].stamps for name, heard in named)

        wait(lambda: all_heard() or time.monotonic() > deadline)
        for name, heard in named:
            track = heard.tracks[name]
            if track.stamps or heard.message is None:
                continue
            try:
                track.read(heard.message)
            except ItemMissingError as error:
                # Without any name a message tells nothing: it may be filled once the machine runs.
                if error.names:
                    problem = f"a message on {heard.name} {error}"
                    raise StudyError(problem, ("signals", name, "field")) from None

    def _subscribe(self, topic: str, cls: Any, offered: QoSProfile) -> tuple[Subscription, bool]:
        qos = QoSProfile(
            depth=DEPTH, reliability=offered.reliability, durability=offered.durability
        )
        # It is in no executor, which would call this.
        subscription = self.node.create_subscription(
            cls, topic, lambda message: None, qos, raw=True
        )
        latched = offered.durability == QoSDurabilityPolicy.TRANSIENT_LOCAL
        return subscription, latched and offered.reliability == QoSReliabilityPolicy.RELIABLE


@dataclass
class _Track:
    """The values of one signal, and when each was true [ns since the epoch].

    Attributes
    ----------
    newest
        What came last, late or not.
    late
        Messages in the run whose stamp is not after that of one before.
    offset
        Time [ns] by which the stamp of the newest is ahead of the clock at its reception.
    stale
        Longest time [ns] for which several of them in a row lie behind, or have come.
    """

    read: Callable[[Any], float]
    by_header: bool
    clock: RunClock
    stamps: list[int] = field(default_factory=list)
    values: list[float] = field(default_factory=list)
    newest: float = np.nan
    late: int = 0
    stale: int = 0
    in_run: bool = False
    offset: int = 0
    late_values: list[float] = field(default_factory=list)
    in_a_row: int = 0
    row_began: int = 0

    def add(self, message: Any, received: int) -> None:
        value = self.newest = self.read(message)
        if self.by_header:
            stamp = message.header.stamp.sec * 1_000_000_000 + message.header.stamp.nanosec
            self.offset = stamp - self.clock.at(received)
        else:
            stamp = self.clock.at(received)
            if self.clock.coarse and self.stamps and stamp == self.stamps[-1]:
                # Of what comes between two ticks of the clock the last one holds.
                self.values[-1] = value
                return
        if self.stamps and stamp <= self.stamps[-1]:
            if self.in_run:
                self._add_late(value, self.stamps[-1] - stamp, self.clock.at(received))
                return
            # What was said of later times holds no more, as of a simulation that was reset.
            while self.stamps and self.stamps[-1] >= stamp:
                self.stamps.pop()
                self.values.pop()
        self.in_a_row = 0
        self.stamps.append(stamp)
        self.values.append(value)

    def take_late(self) -> Array:
        """Return the late values since the last call, and what came last if that is behind."""
        values = [*self.late_values, self.newest] if self.late_values or self.in_a_row else []
        self.late_values.clear()
        return np.array(values)

    def _add_late(self, value: float, behind: int, received: int) -> None:
        self.late += 1
        self.late_values.append(value)
        self.in_a_row += 1
        if self.in_a_row == 1:
            self.row_began = received
        else:
            self.stale = max(self.stale, behind, received - self.row_began)

    def forget(self) -> None:
        self.stamps.clear()
        self.values.clear()
        self.late_values.clear()
        self.newest = np.nan
        self.in_a_row = 0

    def begin(self, now: int, in_run: bool) -> None:
        self.in_run = in_run
        del self.stamps[:-1], self.values[:-1]
        # A stamp may lie ahead, as of a clock that was set back: the value holds now all the same.
        self.stamps[:] = [min(stamp, now - 1) for stamp in self.stamps]
        self.late = self.stale = self.in_a_row = 0
        self.late_values.clear()


@dataclass
class _Topic:
    """A subscription, the signals in its messages, and the last one that could be read."""

    name: str
    node: str
    clock: RunClock
    subscription: Subscription
    is_latched: bool
    of_guard: int = 0
    received: int = 0
    is_continuous: bool = False
    tracks: dict[str, _Track] = field(default_factory=dict)
    lost: LostMessages = field(default_factory=LostMessages)
    problem: str = ""
    message: Any = None

    def begin(self, now: int, in_run: bool) -> None:
        if in_run:
            self.is_continuous = time.time_ns() - self.received < RECENT
        self.lost.count = 0
        self.problem = ""
        for track in self.tracks.values():
            track.begin(now, in_run)

    @property
    def publishers(self) -> int:
        """How many publishers are known here, without that of a guard."""
        found: int = self.subscription.handle.get_publisher_count()
        return max(found - self.of_guard, 0)

    def forget(self) -> None:
        """Forget all that came."""
        self.poll()
        self.message = None
        for track in self.tracks.values():
            track.forget()

    def has_message(self) -> bool:
        """Whether anything came since all was forgotten."""
        self.poll()
        return any(track.stamps for track in self.tracks.values())

    def poll(self) -> None:
        """Take what waits."""
        handle, publishers = self.subscription.handle, self.publishers
        with handle:
            # No more than can wait: a topic that is faster than this loop always has another.
            for _ in range(DEPTH):
                item = handle.take_message(self.subscription.msg_type, True)
                if item is None:
                    break
                data, info = item
                self.received = info["received_timestamp"]
                self.lost.note(info["publication_sequence_number"], publishers)
                try:
                    message = self.message = decode(data, self.subscription.msg_type)
                    for track in self.tracks.values():
                        track.add(message, info["received_timestamp"])
                except (UnreadableError, ItemMissingError) as error:
                    self.problem = f"a message on {self.name} {error}"
