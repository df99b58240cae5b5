"""Plays bags in runs, message by message as the nodes that hear them follow."""

import dataclasses
import threading
import time
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path

from rclpy.node import Node
from rclpy.qos import QoSDurabilityPolicy, QoSProfile

from bo_tuner.backends.ros import others
from bo_tuner.backends.ros.clock import TOPIC as CLOCK
from bo_tuner.backends.ros.errors import LostError
from bo_tuner.backends.ros.messages import has_header, interface_class
from bo_tuner.backends.ros.own_topics import OwnTopic
from bo_tuner.backends.ros.play.answering import answers
from bo_tuner.backends.ros.play.bag import Bag, Message
from bo_tuner.backends.ros.play.lockstep import Lockstep, StoppedError
from bo_tuner.backends.ros.play.noise import Noise
from bo_tuner.backends.ros.play.play_clock import DEPTH, PlayClock
from bo_tuner.backends.ros.publication import CONNECT_TIMEOUT
from bo_tuner.backends.ros.tuner_node import POLL_PERIOD, UNKNOWN_NODE, TunerNode, is_own
from bo_tuner.codec import checks
from bo_tuner.codec.findings import under
from bo_tuner.errors import BackendError, StudyError
from bo_tuner.study.playing import Answer, Play
from bo_tuner.study.signals import Signal

UNSERVED = 0.5
"""Time [s] after which it waits for a tuner that does not look at the run."""
MATCHED = 0.3
"""Time [s] that a node which was started anew has to see who hears it."""


@dataclasses.dataclass(frozen=True)
class _Known:
    """A bag that can be played.

    Attributes
    ----------
    topics : mapping from str to str
        The topics that are played, by their names in the bag.
    heard : list of str
        Those that a node hears.
    """

    bag: Bag
    topics: Mapping[str, str]
    heard: list[str]


class Player:
    """Plays the bag of each run in a thread of its own.

    Attributes
    ----------
    duration : float
        Time [s] that the bag in play takes.
    played : mapping from str to int
        Numbers of messages in the latest run, by topic.
    """

    def __init__(
        self,
        tuner: TunerNode,
        play: Play,
        folder: str,
        signals: Mapping[str, Signal],
        topics: dict[str, OwnTopic],
        clock: PlayClock,
        listener: Node | None,
    ) -> None:
        self._tuner = tuner
        self._folder = Path(folder)
        self._signals = {self._resolved(spec.topic) for spec in signals.values()}
        self._topics = topics
        self._listener = listener
        self._clock = clock
        self._known: dict[str, _Known] = {}
        self.played: Counter[str] = Counter()
        self._over = threading.Event()
        self._over.set()
        self._stopped = threading.Event()
        self._fault: Exception | None = None
        self._thread: threading.Thread | None = None
        self._lockstep = Lockstep(tuner, self._stopped)
        try:
            self.fill(play)
        except BaseException:
            self.close()
            raise

    def fill(self, play: Play) -> None:
        """Play another bag, or otherwise, in the next run."""
        play = self._in_full(play)
        if play.bag not in self._known:
            self._known[play.bag] = self._add(play)
        self._play, bag = play, self._known[play.bag].bag
        self._clock.start = bag.start + round(play.begin * 1e9)
        last = bag.end if play.end is None else bag.start + round(play.end * 1e9)
        self.duration = (min(last, bag.end) - self._clock.start) * 1e-9
        if self.duration <= 0.0:
            total = (bag.end - bag.start) * 1e-9
            raise StudyError(f"the bag is {total:.3g} s long", ("begin",))

    def hear(self, topics: Iterable[str]) -> None:
        """Note what nodes answer on some topics, in runs to come."""
        for topic in topics:
            self._lockstep.hear(topic)

    @property
    def heard(self) -> Sequence[str]:
        """The topics of the bag in play that a node hears."""
        return self._known[self._play.bag].heard

    @property
    def answers(self) -> dict[str, Answer]:
        """On which of the topics that are noted messages were answered in the latest run."""
        return answers(self._lockstep.settled, self._lockstep.answered)

    @property
    def latest(self) -> Mapping[str, bytes]:
        """The latest message on each of the topics that are noted."""
        return self._lockstep.latest

    @property
    def is_over(self) -> bool:
        """Whether the bag has been played, or not begun."""
        return self._over.is_set()

    def begin(self) -> None:
        """Begin to play, once the nodes are connected."""
        known = self._known[self._play.bag]
        deadline = time.monotonic() + CONNECT_TIMEOUT
        for topic in known.heard:
            left = deadline - time.monotonic()
            if not self._tuner.wait_until(partial(self._reaches_all, topic), left):
                raise LostError(f"nothing subscribes to {topic}, which is played")
        # What a node answers is lost as long as it does not know who hears it.
        self._tuner.spin_for(MATCHED)
        if self._play.lockstep:
            self._lockstep.begin(known.topics.values(), dict(self._play.answers))
        self._fault = None
        self.played = Counter()
        self._stopped.clear()
        self._over.clear()
        self._thread = threading.Thread(target=self._go_on, name="player", daemon=True)
        self._thread.start()

    def check(self) -> None:
        """Raise why the bag is not played on."""
        if self._fault is not None:
            raise self._fault

    def stop(self) -> None:
        """End it."""
        self._stopped.set()
        if self._thread is not None:
            self._thread.join()
            self._thread = None

    def close(self) -> None:
        """End it, and leave ROS."""
        self.stop()
        self._lockstep.close()

    def _go_on(self) -> None:
        at = self._clock.start
        self._began = time.monotonic()
        try:
            for at, topic, data in self._messages():
                self._wait_until_due(at)
                if self._clock.tick(at) and self._play.lockstep:
                    # Timers of a node may be due.
                    self._lockstep.settle(CLOCK, self._play.timeout)
                self._topics[topic].publish(data)
                self.played[topic] += 1
                if self._play.lockstep:
                    self._lockstep.settle(topic, self._play.timeout)
            self._refuse_late()
        except StoppedError:
            pass
        except LostError as loss:
            seconds = (at - self._known[self._play.bag].bag.start) * 1e-9
            self._fault = LostError(f"{loss}, at {seconds:.3f} s of {self._play.bag}")
        except Exception as error:
            # Such as of the middleware: without this, nobody would hear of it.
            self._fault = error
        finally:
            self._over.set()

    def _messages(self) -> Iterator[Message]:
        """Yield what is played, by the topics as they are played."""
        play, known = self._play, self._known[self._play.bag]
        in_bag = {topic: name for name, topic in known.topics.items()}
        delay, drop = (
            {in_bag[topic]: float(amount) for topic, amount in amounts.items()}
            for amounts in (play.delay, play.drop)
        )
        noise = self._noise(play, known.bag, known.topics)
        try:
            for message in known.bag.messages(known.topics, play.begin, play.end, delay, drop):
                topic, data = known.topics[message.topic], message.data
                if topic in noise:
                    data = noise[topic](data)
                yield Message(message.time, topic, data)
        except StudyError as error:
            # It has been read before: it is gone or changed since.
            raise BackendError(str(error)) from error

    @staticmethod
    def _noise(play: Play, bag: Bag, topics: Mapping[str, str]) -> dict[str, Noise]:
        """Return what adds noise, by the topic as it is played."""
        made = {}
        for name, topic in topics.items():
            if topic in play.noise:
                amounts = {path: float(item) for path, item in play.noise[topic].items()}
                with under("noise", topic):
                    made[topic] = Noise(topic, bag.types[name], amounts)
        return made

    def _refuse_late(self) -> None:
        """Raise `StudyError` if a node hears a topic by now that was therefore not played."""
        known = self._known[self._play.bag]
        for name in set() if self._play.topics else known.bag.types.keys() - known.topics.keys():
            topic = self._play.remap.get(name, name)
            infos = others.subscribers(self._tuner.node, topic)
            if infos and not others.publishers(self._tuner.node, topic):
                raise StudyError(
                    f"{infos[0].node_name} hears {topic} only after the bag was begun; name what "
                    "is played, so that it is waited for",
                    ("topics",),
                )

    def _wait_until_due(self, at: int) -> None:
        """Wait until a time [ns] of the bag, and for a tuner that does not look at the run."""
        rate = self._play.rate if self._play.rate or self._play.lockstep else 1.0
        if rate is not None:
            due = self._began + (at - self._clock.start) * 1e-9 / rate
            self._stopped.wait(max(due - time.monotonic(), 0.0))
        while time.monotonic() - self._tuner.served > UNSERVED and not self._stopped.is_set():
            self._stopped.wait(POLL_PERIOD)
        if self._stopped.is_set():
            raise StoppedError

    def _add(self, play: Play) -> _Known:
        """Read a bag that was not played before, and find who hears it."""
        bag = Bag(self._folder / play.bag)
        for name, other in self._known.items():
            if bag.overlaps(other.bag):
                raise StudyError(
                    f"{checks.quoted(play.bag)} has been recorded at the same time as "
                    f"{checks.quoted(name)}; expected one bag of a drive",
                    ("bag",),
                )
        topics = self._find_topics(play, bag)
        if timing := others.publishers(self._tuner.node, CLOCK):
            raise StudyError(
                f"{timing[0].node_name} publishes {CLOCK}, which in such a run is the time of the "
                "bag; end that, or remap it"
            )
        stamped = {name for name, topic in topics.items() if self._offer(topic, bag.types[name])}
        bag.check(topics, stamped)
        for key in ("answers", "delay", "drop", "noise"):
            for name in getattr(play, key):
                checks.reference(name, "topic that is played", topics.values(), key, name)
        self._noise(play, bag, topics)
        for name, spec in play.answers.items():
            with under("answers", name):
                self._lockstep.hear(spec.topic)
        heard = [topic for topic in topics.values() if others.subscribers(self._tuner.node, topic)]
        return _Known(bag, topics, heard)

    def _find_topics(self, play: Play, bag: Bag) -> dict[str, str]:
        """Return the topics to be played by their names in the bag."""
        for name in play.remap:
            checks.reference(name, "topic in the bag", bag.types, "remap", name)
        for index, name in enumerate(play.topics):
            checks.reference(name, "topic in the bag", bag.types, "topics", index)
        names = {name: play.remap.get(name, name) for name in play.topics or bag.types}

        def heard() -> list[str]:
            return [
                topic for topic in names.values() if others.subscribers(self._tuner.node, topic)
            ]

        def is_heard() -> bool:
            # What is named is waited for.
            named = set(names.values()) - self._signals if play.topics else set()
            return bool(heard()) and named <= {*heard()}

        if not self._tuner.wait_until(is_heard, CONNECT_TIMEOUT) and not heard():
            listed = ", ".join(sorted(names.values()))
            raise StudyError(
                f"no node hears a topic of {checks.quoted(play.bag)}, which has {listed}", ("bag",)
            )
        self._tuner.spin_for(MATCHED)
        played = {}
        for name, topic in names.items():
            problem = ""
            if topic not in heard() and topic not in self._signals:
                problem = f"nothing hears {topic}; heard are {', '.join(heard())}"
            elif publishers := others.publishers(self._tuner.node, topic):
                problem = (
                    f"{publishers[0].node_name} publishes {topic}, too, so that messages would "
                    "mix; leave it out, or remap it"
                )
            else:
                played[name] = topic
            if problem and play.topics:
                raise StudyError(problem, ("topics", play.topics.index(name)))
        return played

    def _offer(self, topic: str, kind: str) -> bool:
        """Publish a topic; returns whether its messages begin with a header."""
        infos = others.subscribers(self._tuner.node, topic)
        with under("topics"):
            cls = interface_class(kind)
            for info in infos:
                if info.topic_type != kind:
                    raise StudyError(
                        f"{topic} carries {kind} in the bag, and {info.node_name} hears "
                        f"{info.topic_type}"
                    )
        if topic not in self._topics:
            latched = QoSDurabilityPolicy.TRANSIENT_LOCAL
            is_latched = any(info.qos_profile.durability == latched for info in infos)
            durability = latched if is_latched else QoSDurabilityPolicy.VOLATILE
            # A reliable publisher is heard by whoever wants less.
            qos = QoSProfile(depth=DEPTH, durability=durability)
            publisher = self._tuner.node.create_publisher(cls, topic, qos)
            self._topics[topic] = OwnTopic(publisher, cls, self._listener)
        return has_header(cls) and next(iter(cls.get_fields_and_field_types())) == "header"

    def _reaches_all(self, topic: str) -> bool:
        infos = self._tuner.node.get_subscriptions_info_by_topic(topic)
        named = all(info.node_name != UNKNOWN_NODE for info in infos)
        own = sum(is_own(info.node_name) for info in infos)
        count = self._topics[topic].publisher.get_subscription_count()
        return bool(named and len(infos) > own and count >= len(infos))

    def _in_full(self, play: Play) -> Play:
        """Return what is played with the full names of topics."""
        full = self._resolved
        return dataclasses.replace(
            play,
            topics=tuple(full(name) for name in play.topics),
            remap={full(name): full(other) for name, other in play.remap.items()},
            answers={
                full(name): Answer(topic=full(answer.topic), every=answer.every)
                for name, answer in play.answers.items()
            },
            delay={full(name): amount for name, amount in play.delay.items()},
            drop={full(name): amount for name, amount in play.drop.items()},
            noise={full(name): amounts for name, amounts in play.noise.items()},
        )

    def _resolved(self, topic: str) -> str:
        return str(self._tuner.node.resolve_topic_name(topic))
