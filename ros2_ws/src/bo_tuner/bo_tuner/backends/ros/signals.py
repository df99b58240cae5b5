"""Hears the signals of a study, each from the node that publishes it, or those that may."""

import time
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from rclpy.context import Context
from rclpy.node import Node

from bo_tuner import maxima
from bo_tuner.backends.ros.clock import LARGEST_JUMP, RunClock, Stopwatch, WallClock
from bo_tuner.backends.ros.errors import LostError
from bo_tuner.backends.ros.fields import ItemMissingError
from bo_tuner.backends.ros.heard_topic import HeardTopic
from bo_tuner.backends.ros.messages import interface_class, type_name
from bo_tuner.backends.ros.publishers import (
    Publishers,
    expected_publishers,
    node_of,
    several_on,
)
from bo_tuner.backends.ros.readers import (
    FieldReader,
    FramesReader,
    Reader,
    TransformFeed,
    reader_of,
)
from bo_tuner.backends.ros.taking import middleware
from bo_tuner.backends.ros.tracks import Track
from bo_tuner.backends.ros.tuner_node import NODE_NAME as TUNER
from bo_tuner.backends.ros.tuner_node import UNKNOWN_NODE, full_name
from bo_tuner.codec.findings import under
from bo_tuner.errors import StudyError
from bo_tuner.metrics.latest_messages import LatestMessage
from bo_tuner.metrics.recording import (
    FailedRunError,
    RecordedMessages,
    RecordedSignal,
    Recording,
)
from bo_tuner.numerics.arrays import Array
from bo_tuner.study.fields import has_names, parsed_field
from bo_tuner.study.signals import STATIC, Signal

NODE_NAME = f"{TUNER}_signals"
RECENT = 1_000_000_000
"""Time [ns] ahead of a run in which a topic has a message that is not only published in runs."""
LISTEN = 1.0
"""Time [s] to hear a message, which has the names of items."""
FRAMES = 3.0
"""Time [s] to hear of all frames on the way between two."""


class SignalRecorder:
    """Records the signals of a run, and monitors them while it lasts.

    Messages wait in the middleware, which notes when they came in, until `poll` takes them; none
    of them wakes up the tuner.

    Attributes
    ----------
    node : Node
        The recorder's node, which is in no executor.
    """

    def __init__(
        self,
        context: Context,
        signals: Mapping[str, Signal],
        guarded: Collection[str] = (),
        keep: Callable[[LatestMessage], object] | None = None,
    ) -> None:
        self._signals = signals
        self._guarded = guarded
        self._clock: RunClock = WallClock()
        self.node = Node(
            NODE_NAME, context=context, enable_rosout=False, start_parameter_services=False
        )
        self._topics: dict[str, _Topic] = {}
        self._tracks: dict[str, Track] = {}
        self._keep = keep
        self._frames: dict[str, FramesReader] = {}
        self._feeds: dict[str, TransformFeed] = {}
        self._began = 0
        self._watch = Stopwatch(self._clock)

    def connect(self, clock: RunClock, wait: Callable[[Callable[[], bool]], bool]) -> None:
        """Subscribe to every signal."""
        self._clock = clock
        for name, spec in self._signals.items():
            with under("signals", name):
                self._connect(name, spec, wait)
        published = [topic for topic in self._topics.values() if topic.publishes]
        # What is published before a subscription is known to the publisher is lost.
        wait(lambda: all(topic.publishers for topic in published))
        # So that also what is published only now and then has a value when a run starts.
        latched = [topic for topic in published if topic.heard.is_latched]

        def all_heard() -> bool:
            self.take()
            return all(topic.has_message for topic in latched)

        wait(all_heard)
        self._refuse_unknown_items(wait)
        self._refuse_unknown_frames(wait)

    @property
    def publishers(self) -> set[str]:
        """Full names of the nodes that publish the signals, as far as the graph has them."""
        return {
            full_name(info.node_namespace, info.node_name)
            for topic in self._topics.values()
            for info in topic.heard.publishers.now()
            if info.node_name != UNKNOWN_NODE
        }

    @property
    def mixed(self) -> str:
        """Return a line on a signal that more than one node publishes; empty if none."""
        for name, spec in self._signals.items():
            topic = self._topic_of(name)
            if topic.publishers > 1 and (mixed := topic.heard.publishers.mixed(spec)):
                return f"{mixed}, whose messages mix"
        return ""

    @property
    def mixed_frames(self) -> str:
        """Return a line on a frame that more than one node has placed since `begin`."""
        mixed = next(filter(None, (reader.mixed for reader in self._frames.values())), "")
        return mixed and f"{mixed}, whose messages mix"

    @property
    def unpublished(self) -> str:
        """Return a line on a topic that nobody publishes any more; empty if none."""
        return self.unpublished_of(self._signals)

    def unpublished_of(self, names: Iterable[str]) -> str:
        """Return a line on a topic of some signals that nobody publishes; empty if none."""
        for name in names:
            spec, topic = self._signals[name], self._topic_of(name)
            if topic.publishers == 0:
                of = f", which was {' and '.join(sorted(topic.nodes))}" if topic.nodes else ""
                return f"{topic.heard.name} has no publisher any more{of}"
            if spec.publisher and not topic.heard.publishers.has_own(spec):
                return f"{topic.heard.name} is not published by {spec.publisher} any more"
        return ""

    def expect_publishers(self) -> None:
        """Raise `LostError` if nothing publishes a signal any more."""
        if unpublished := self.unpublished:
            raise LostError(unpublished)

    @property
    def stale(self) -> str:
        """Return a line on a signal with messages that are all late for too long; empty if none.

        Messages that are reordered are late one by one. If several in a row are late for long, a
        stamp before them was wrong, or the clock of the stamps was set or stands still.
        """
        for name, spec in self._signals.items():
            stale = self._tracks[name].stale * 1e-9
            if stale > LARGEST_JUMP:
                return (
                    f"the stamps of signal {name} ({spec.source}) stand still or go back, "
                    f"for {stale:.3g} s"
                )
        return ""

    def begin(self, in_run: bool = True) -> None:
        """Count time from now on, and of what came before only the latest.

        In a run a message whose stamp is not after that of the one before is late; otherwise what
        comes last holds, as a simulation may be reset.
        """
        self.take()
        self._began = self._clock.now
        self._watch = Stopwatch(self._clock)
        for topic in self._topics.values():
            topic.heard.begin()
            if in_run:
                topic.is_continuous = time.time_ns() - topic.received < RECENT
        for feed in self._feeds.values():
            feed.tree.begin()
        for track in self._tracks.values():
            track.begin(self._began, in_run)

    def forget_ended(
        self, also: Collection[str], wait: Callable[[Callable[[], bool]], bool]
    ) -> None:
        """Forget what was said by publishers that are gone: it holds for no further run."""
        names = {UNKNOWN_NODE} | {name for name, _ in self.node.get_node_names_and_namespaces()}
        topics = self._topics.values()
        ended = [t for t in topics if not (t.publishers and names.intersection(t.nodes))]
        wait(lambda: all(topic.publishers == 0 for topic in ended))
        self.take()
        for topic in topics:
            # Where others publish it, too, what they say comes again; transforms are kept.
            if topic.publishes and (
                topic.publishers == 0
                or not names.issuperset(topic.nodes)
                or not topic.nodes.isdisjoint(also)
            ):
                topic.has_message = False
                for name in topic.readers:
                    self._tracks[name].forget()

    @property
    def awaits_first(self) -> bool:
        """Whether a topic that was published ahead of the last run, too, has no message yet."""
        self.take()
        return not all(t.has_message for t in self._topics.values() if t.is_continuous)

    def end(self) -> None:
        """End a run."""
        for track in self._tracks.values():
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
        stamps = [track.stamps[-1] for track in self._tracks.values() if track.stamps]
        return (max(stamps, default=self._began) - self._began) * 1e-9

    def poll(self) -> None:
        """Take what came in."""
        if problem := self.take():
            raise FailedRunError(problem)

    def take(self) -> str:
        """Take what came in; returns what is wrong with it in a line, or an empty one."""
        problem = ""
        for topic in self._topics.values():
            for heard in topic.heard.take():
                topic.has_message = True
                topic.received = heard.received
                if self._keep is not None:
                    name, data = topic.heard.name, heard.data
                    self._keep(LatestMessage(heard.received, name, topic.type, data))
                for name, reader in topic.readers.items():
                    track = self._tracks[name]
                    try:
                        for stamp, value in reader(heard):
                            track.add(stamp, value, heard.received)
                    except ItemMissingError as error:
                        problem = f"a message on {topic.heard.name} {error}"
                    if track.size > maxima.MESSAGES_BYTES:
                        problem = (
                            f"signal {name} has {track.size} bytes of messages, expected at most "
                            f"{maxima.MESSAGES_BYTES} in a run"
                        )
            problem, topic.heard.problem = topic.heard.problem or problem, ""
        return problem

    def take_late(self) -> Iterator[dict[str, Array]]:
        """Yield the late messages of a topic that came since the last call, and what came last.

        Values (n,) of its signals by their names, and beside them the newest of the others, ().
        """
        numbers = {name for name, spec in self._signals.items() if spec.is_number}
        newest = {name: np.array(self._tracks[name].newest) for name in numbers}
        for topic in self._topics.values():
            late = {
                name: self._tracks[name].take_late() for name in topic.readers if name in numbers
            }
            if any(map(len, late.values())):
                yield newest | {name: values for name, values in late.items() if len(values)}

    def recording(self, end: float, since: float = -np.inf) -> Recording:
        """Return what was recorded until `end` [s], from the last message before `since` [s] on."""
        signals, messages = {}, {}
        for name, spec in self._signals.items():
            topic, track = self._topic_of(name), self._tracks[name]
            times, values = track.between(self._began, since, end)
            node = node_of(self.node, spec) if spec.publisher else ""
            seen: dict[str, Any] = {
                "lost": topic.heard.lost(node),
                "late": track.late,
                "offset": track.offset * 1e-9,
                "remark": self._remark(name),
            }
            if spec.is_number:
                signals[name] = RecordedSignal(times, np.array(values, dtype=np.float64), **seen)
            else:
                kind = type_name(topic.heard.cls)
                data = tuple(value for value in values if isinstance(value, bytes))
                messages[name] = RecordedMessages(times, kind, data, **seen)
        return Recording(signals, end, messages)

    def close(self) -> None:
        """Hear no more."""
        self.node.destroy_node()

    def _topic_of(self, name: str) -> "_Topic":
        return self._topics[self.node.resolve_topic_name(self._signals[name].topic)]

    def _remark(self, name: str) -> str:
        """Say why a signal has no message, as far as that is known."""
        if self._tracks[name].stamps:
            return ""
        if name in self._frames:
            missing = self._frames[name].missing
            return f"there is {missing}" if missing.startswith("no ") else missing
        heard = self._topic_of(name).heard
        if self._signals[name].publisher and heard.unidentified:
            return f"{middleware()} does not tell of which publisher a message is"
        return ""

    def _connect(self, name: str, spec: Signal, wait: Callable[[Callable[[], bool]], bool]) -> None:
        topic = self.node.resolve_topic_name(spec.topic)
        publishers = expected_publishers(self.node, topic, spec, wait)
        if len(kinds := sorted({info.topic_type for info in publishers})) > 1:
            raise StudyError(f"{topic} carries {' and '.join(kinds)}; expected one", ("topic",))
        (kind,) = kinds
        if spec.type not in ("", kind):
            raise StudyError(f"{topic} carries {kind}, expected {spec.type}", ("type",))
        with under("topic"):
            cls = interface_class(kind)
        known = self._topics.get(topic)
        if known is not None and known.heard.cls is not cls:
            other = type_name(known.heard.cls)
            raise StudyError(f"{topic} carries {kind}, and {other} for another signal", ("topic",))
        reader = reader_of(spec, cls, self.node, self._feeds)
        if isinstance(reader, FramesReader):
            self._frames[name] = reader
            self._topic(f"{topic}{STATIC}", cls).readers[name] = reader.still
        here = self._topic(topic, cls)
        if spec.publisher and not here.heard.knows_publisher:
            raise StudyError(
                f"{middleware()} does not tell of which publisher a message is; expected one "
                "publisher, or merge: true",
                ("publisher",),
            )
        here.readers[name] = reader
        self._tracks[name] = Track(self._clock)

    def _topic(self, name: str, cls: type) -> "_Topic":
        """Return a topic that is heard, from now on if it is not yet."""
        if name not in self._topics:
            offered = Publishers(self.node, name).now()
            several = several_on(self.node, name, self._signals.values())
            heard = HeardTopic(self.node, name, cls, offered, knows_publisher=several)
            self._topics[name] = _Topic(
                heard,
                frozenset(i.node_name for i in offered if i.node_name != UNKNOWN_NODE),
                is_guarded=name in self._guarded,
                publishes=bool(offered),
            )
        return self._topics[name]

    def _refuse_unknown_items(self, wait: Callable[[Callable[[], bool]], bool]) -> None:
        """Refuse an item by a name that messages do not have; a silent topic may have it later."""
        named = [
            name
            for name, spec in self._signals.items()
            if spec.is_number and has_names(parsed_field(spec.field))
        ]
        deadline = time.monotonic() + LISTEN

        def all_heard() -> bool:
            self.take()
            return all(self._tracks[name].stamps for name in named)

        wait(lambda: all_heard() or time.monotonic() > deadline)
        for name in named:
            topic = self._topic_of(name)
            reader = topic.readers[name]
            if self._tracks[name].stamps or not isinstance(reader, FieldReader):
                continue
            # A message without any name decides nothing: it may have them once the machine runs.
            if reader.missing is not None and reader.missing.names:
                problem = f"a message on {topic.heard.name} {reader.missing}"
                raise StudyError(problem, ("signals", name, "field"))

    def _refuse_unknown_frames(self, wait: Callable[[Callable[[], bool]], bool]) -> None:
        """Refuse frames that nobody places, or two; a silent topic may have them later."""
        begin = time.monotonic()

        def is_known() -> bool:
            self.take()
            elapsed = time.monotonic() - begin
            # Whoever else places a frame shows only after a while.
            return elapsed > FRAMES or (
                elapsed > LISTEN and all(self._tracks[name].stamps for name in self._frames)
            )

        if self._frames:
            wait(is_known)
        for name, reader in self._frames.items():
            path = ("signals", name, "frames")
            topic = self._topic_of(name).heard.name
            if missing := reader.missing:
                raise StudyError(f"{topic}: {missing}", path)
            if mixed := reader.mixed:
                raise StudyError(f"{topic}: {mixed}, whose messages would mix", path)


@dataclass
class _Topic:
    """A topic, and what reads its messages.

    Attributes
    ----------
    heard
        Takes its messages.
    nodes
        Names of the nodes that published it when it was first heard.
    is_guarded
        Whether a guard has a publisher of it, which is silent.
    publishes
        Whether anybody did then; transforms that stand still need not have a publisher.
    readers
        The signals in it, by name.
    has_message
        Whether anything came since all was forgotten.
    received
        When the last message came [ns].
    is_continuous
        Whether one came right ahead of the last run, so that there are such between runs, too.
    """

    heard: HeardTopic
    nodes: frozenset[str]
    is_guarded: bool
    publishes: bool
    readers: dict[str, Reader] = field(default_factory=dict)
    has_message: bool = False
    received: int = 0
    is_continuous: bool = False

    @cached_property
    def type(self) -> str:
        """Type of its messages."""
        return type_name(self.heard.cls)

    @property
    def publishers(self) -> int:
        """How many publishers are known here, without that of a guard."""
        count: int = self.heard.subscription.handle.get_publisher_count()
        if not self.is_guarded:
            return count
        # The graph shows whether the only one left is the guard's or not.
        return count - 1 if count > 1 else len(self.heard.publishers.now())
