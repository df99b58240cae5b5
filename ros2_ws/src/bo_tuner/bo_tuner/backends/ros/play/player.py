"""Plays bags in runs, message by message as the nodes that hear them follow."""

import threading
import time
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import Any

from rcl_interfaces.srv import GetParameters
from rclpy.client import Client
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import QoSDurabilityPolicy, QoSProfile
from rosgraph_msgs.msg import Clock as ClockMessage

from bo_tuner.backends.ros.clock import TOPIC as CLOCK
from bo_tuner.backends.ros.errors import LostError
from bo_tuner.backends.ros.heard_topic import weakest
from bo_tuner.backends.ros.messages import has_header, interface_class
from bo_tuner.backends.ros.own_topics import OwnTopic
from bo_tuner.backends.ros.play.bag import Bag
from bo_tuner.backends.ros.play.play_clock import PlayClock
from bo_tuner.backends.ros.publication import CONNECT_TIMEOUT
from bo_tuner.backends.ros.tuner_node import (
    NODE_NAME,
    POLL_PERIOD,
    UNKNOWN_NODE,
    TunerNode,
    full_name,
    is_own,
)
from bo_tuner.errors import StudyError
from bo_tuner.metrics.recording import FailedRunError
from bo_tuner.study import checks
from bo_tuner.study.building import under
from bo_tuner.study.playing import Play
from bo_tuner.study.signals import Signal

UNSERVED = 0.5
"""Time [s] after which it waits for a tuner that does not look at the run."""
DEPTH = 1000
"""Messages of a topic that may wait for a node."""
MATCHED = 0.3
"""Time [s] that a node which was started anew has to see who hears it."""
QUESTION = GetParameters.Request(names=["use_sim_time"])


class Player:
    """Plays the bag of each run in a thread of its own.

    A node is done with a message when it answers a question on its parameters: that comes after
    the message, on the same way, and a node with one thread works on it after the message. What
    the node has published meanwhile has come, too.

    Parameters
    ----------
    tuner
        The tuner's node.
    play
        What is played, with values for names in braces.
    folder
        The study's.
    signals
        The study's signals, which may be of topics of the bag.
    topics
        What the steps publish, by topic; those of the bags are added.
    listener
        Hears whether others publish them; None not to listen.

    Attributes
    ----------
    clock : PlayClock
        The time of the bag.
    duration : float
        Time [s] that the bag in play takes.

    Raises
    ------
    StudyError
        If a bag cannot be read, or no node hears it, or not as the study says.
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
        self._signals = {tuner.node.resolve_topic_name(s.topic) for s in signals.values()}
        self._topics = topics
        self._listener = listener
        self.clock = clock
        self._bags: dict[str, Bag] = {}
        self._names: dict[str, dict[str, str]] = {}
        self._heard: dict[str, list[str]] = {}
        self._over = threading.Event()
        self._over.set()
        self._stopped = threading.Event()
        self._fault: Exception | None = None
        self._thread: threading.Thread | None = None
        self._node = Node(
            f"{NODE_NAME}_player",
            context=tuner.context,
            enable_rosout=False,
            start_parameter_services=False,
        )
        self._executor = SingleThreadedExecutor(context=tuner.context)
        self._executor.add_node(self._node)
        self._questions: dict[str, Client] = {}
        self._answers: dict[str, int] = {}
        try:
            self.fill(play)
        except BaseException:
            self.close()
            raise

    def fill(self, play: Play) -> None:
        """Play another bag, or another part of it, in the next run.

        Raises
        ------
        StudyError
            If it cannot be read, or no node hears it, or not as the study says.
        """
        if play.bag not in self._bags:
            self._add(play)
        self._play, self._bag = play, self._bags[play.bag]
        self.clock.start = self._bag.start + round(play.begin * 1e9)
        last = self._bag.end if play.end is None else self._bag.start + round(play.end * 1e9)
        self.duration = (min(last, self._bag.end) - self.clock.start) * 1e-9
        if self.duration <= 0.0:
            total = (self._bag.end - self._bag.start) * 1e-9
            raise StudyError(f"the bag is {total:.3g} s long", ("begin",))

    @property
    def is_over(self) -> bool:
        """Whether the bag has been played, or not begun."""
        return self._over.is_set()

    def begin(self) -> None:
        """Begin to play, once the nodes are connected.

        Raises
        ------
        LostError
            If a node is not there.
        """
        deadline = time.monotonic() + CONNECT_TIMEOUT
        for topic in self._heard[self._play.bag]:
            left = deadline - time.monotonic()
            if not self._tuner.wait_until(partial(self._reaches_all, topic), left):
                raise LostError(f"nothing subscribes to {topic}, which is played")
        # What a node answers is lost as long as it does not know who hears it.
        self._tuner.spin_for(MATCHED)
        self._followers = self._find_followers()
        self._drain()
        self._answers = dict.fromkeys(self._answers, 0)
        self._fault = None
        self._stopped.clear()
        self._over.clear()
        self._thread = threading.Thread(target=self._go_on, name="player", daemon=True)
        self._thread.start()

    def check(self) -> None:
        """Raise why the bag is not played on.

        Raises
        ------
        LostError
            If a node does not follow.
        StudyError
            If the rest of the bag cannot be read.
        """
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
        self._executor.shutdown()
        self._node.destroy_node()

    def _go_on(self) -> None:
        play, names = self._play, self._names[self._play.bag]
        in_bag = {topic: name for name, topic in names.items()}
        delay, drop = (
            {in_bag[self._resolved(topic)]: float(amount) for topic, amount in amounts.items()}
            for amounts in (play.delay, play.drop)
        )
        rate = play.rate if play.rate or play.lockstep else 1.0
        sent = dict.fromkeys(play.answers, 0)
        began = time.monotonic()
        try:
            for message in self._bag.messages(names, play.begin, play.end, delay, drop):
                if rate is not None:
                    due = began + (message.time - self.clock.start) * 1e-9 / rate
                    self._stopped.wait(max(due - time.monotonic(), 0.0))
                while time.monotonic() - self._tuner.served > UNSERVED:
                    self._stopped.wait(POLL_PERIOD)
                    if self._stopped.is_set():
                        return
                if self._stopped.is_set():
                    return
                if self.clock.tick(message.time) and play.lockstep:
                    # Timers of a node may be due.
                    self._settle(self._followers[CLOCK], message.time)
                topic = names[message.topic]
                self._topics[topic].publish(message.data)
                if topic in sent:
                    sent[topic] += 1
                    self._await_answer(topic, sent[topic], message.time)
                elif play.lockstep:
                    self._settle(self._followers[topic], message.time)
        except _StoppedError:
            pass
        except Exception as error:
            self._fault = error
        finally:
            self._over.set()

    def _settle(self, nodes: list[str], now: int) -> None:
        """Wait until nodes are done with what was published."""
        asked = [(name, self._questions[name]) for name in nodes]
        answers = [(name, client, client.call_async(QUESTION)) for name, client in asked]
        try:
            for name, _, answer in answers:
                self._spin_until(answer.done, f"{name} does not answer", now)
        finally:
            for _, client, answer in answers:
                client.remove_pending_request(answer)

    def _await_answer(self, topic: str, sent: int, now: int) -> None:
        spec = self._play.answers[topic]
        on = self._resolved(spec.topic)
        due = sent // spec.every
        what = f"no answer on {on} to message {sent} of {topic}"
        self._spin_until(lambda: self._answers[on] >= due, what, now)

    def _spin_until(self, condition: Callable[[], bool], problem: str, now: int) -> None:
        deadline = time.monotonic() + self._play.timeout
        while not condition():
            if self._stopped.is_set():
                raise _StoppedError
            if time.monotonic() > deadline:
                at = (now - self._bag.start) * 1e-9
                raise LostError(
                    f"{problem} within {self._play.timeout:g} s, at {at:.3f} s of the bag"
                )
            self._executor.spin_once(timeout_sec=POLL_PERIOD)

    def _drain(self) -> None:
        """Take what has come since the last run."""
        before = -1
        while before != (now := sum(self._answers.values())):
            before = now
            self._executor.spin_once(timeout_sec=POLL_PERIOD)

    def _add(self, play: Play) -> None:
        """Read a bag that was not played before, and find who hears it."""
        node = self._tuner.node
        bag = Bag(self._folder / play.bag)
        remap = {self._resolved(old): self._resolved(new) for old, new in play.remap.items()}
        for name in remap:
            checks.reference(name, "topic in the bag", bag.types, "remap", name)
        wanted = [self._resolved(name) for name in play.topics]
        for index, name in enumerate(wanted):
            checks.reference(name, "topic in the bag", bag.types, "topics", index)
        names = {name: remap.get(name, name) for name in wanted or bag.types}

        def heard() -> list[str]:
            return [topic for topic in names.values() if self._others(topic)]

        if not self._tuner.wait_until(lambda: bool(heard()), CONNECT_TIMEOUT):
            raise StudyError(
                f"no node hears a topic of {checks.quoted(play.bag)}, which has "
                f"{', '.join(sorted(names.values()))}",
                ("bag",),
            )
        self._tuner.spin_for(MATCHED)
        played = {}
        for name, topic in names.items():
            publishers = node.get_publishers_info_by_topic(topic)
            others = [i.node_name for i in publishers if not is_own(i.node_name)]
            if not self._others(topic) and topic not in self._signals:
                if wanted:
                    raise StudyError(
                        f"nothing hears {topic}; heard are {', '.join(heard())}",
                        ("topics", wanted.index(name)),
                    )
            elif others and wanted:
                raise StudyError(
                    f"{others[0]} publishes {topic}, too, so that messages would mix; leave it "
                    "out, or remap it",
                    ("topics", wanted.index(name)),
                )
            elif not others:
                played[name] = topic
        stamped = {name for name, topic in played.items() if self._offer(topic, bag.types[name])}
        bag.check(stamped)
        for key in ("answers", "delay", "drop"):
            for name in getattr(play, key):
                known = played.values()
                checks.reference(self._resolved(name), "topic that is played", known, key, name)
        for name, spec in play.answers.items():
            with under("answers", name):
                self._hear(self._resolved(spec.topic))
        self._bags[play.bag], self._names[play.bag] = bag, played
        self._heard[play.bag] = [topic for topic in played.values() if self._others(topic)]

    def _offer(self, topic: str, kind: str) -> bool:
        """Publish a topic; returns whether its messages begin with a header."""
        with under("topics"):
            cls = interface_class(kind)
            for info in self._others(topic):
                if info.topic_type != kind:
                    raise StudyError(
                        f"{topic} carries {kind} in the bag, and {info.node_name} hears "
                        f"{info.topic_type}"
                    )
        if topic not in self._topics:
            latched = any(
                info.qos_profile.durability == QoSDurabilityPolicy.TRANSIENT_LOCAL
                for info in self._others(topic)
            )
            durability = (
                QoSDurabilityPolicy.TRANSIENT_LOCAL if latched else QoSDurabilityPolicy.VOLATILE
            )
            # A reliable publisher is heard by whoever wants less.
            qos = QoSProfile(depth=DEPTH, durability=durability)
            publisher = self._tuner.node.create_publisher(cls, topic, qos)
            self._topics[topic] = OwnTopic(publisher, cls, self._listener)
        return next(iter(cls.get_fields_and_field_types()), "") == "header" and has_header(cls)

    def _hear(self, topic: str) -> None:
        """Count the answers on a topic."""
        if topic in self._answers:
            return
        node = self._tuner.node

        def offered() -> list[Any]:
            return [i for i in node.get_publishers_info_by_topic(topic) if not is_own(i.node_name)]

        if not self._tuner.wait_until(lambda: bool(offered()), CONNECT_TIMEOUT):
            raise StudyError(f"nothing publishes {topic}", ("topic",))
        infos = offered()

        def count(message: bytes) -> None:
            self._answers[topic] += 1

        self._answers[topic] = 0
        self._node.create_subscription(
            interface_class(infos[0].topic_type),
            topic,
            count,
            weakest([info.qos_profile for info in infos]),
            raw=True,
        )

    def _find_followers(self) -> dict[str, list[str]]:
        """Return the nodes that are waited for, by the topic that they hear."""
        if not self._play.lockstep:
            return {}
        names = [*self._names[self._play.bag].values(), CLOCK]
        followers = {topic: list(self._hearing(topic)) for topic in names}
        of_bag = {name for topic in names[:-1] for name in followers[topic]}
        answered = {self._resolved(topic) for topic in self._play.answers}
        followers[CLOCK] = [name for name in followers[CLOCK] if name in of_bag]
        for topic in names:
            if topic in answered:
                followers[topic] = []
            for name in followers[topic]:
                self._expect_services(name, topic)
        return followers

    def _expect_services(self, name: str, topic: str) -> None:
        if name not in self._questions:
            self._questions[name] = self._node.create_client(GetParameters, f"{name}/get_parameters")
        ready = self._questions[name].service_is_ready
        if not self._tuner.wait_until(ready, CONNECT_TIMEOUT):
            raise StudyError(
                f"{name} has no parameter services, by which the player sees that it is done with "
                f"a message; name what it answers {topic} on in answers, or put lockstep: false",
                ("run", "start", 0, "play", "lockstep"),
            )

    def _hearing(self, topic: str) -> Iterator[str]:
        for info in self._others(topic):
            if info.node_name != UNKNOWN_NODE:
                yield full_name(info.node_namespace, info.node_name)

    def _others(self, topic: str) -> list[Any]:
        """Return the subscriptions of others to a topic."""
        infos = self._tuner.node.get_subscriptions_info_by_topic(topic)
        return [info for info in infos if not is_own(info.node_name)]

    def _reaches_all(self, topic: str) -> bool:
        infos = self._tuner.node.get_subscriptions_info_by_topic(topic)
        named = all(info.node_name != UNKNOWN_NODE for info in infos)
        own = sum(is_own(info.node_name) for info in infos)
        count = self._topics[topic].publisher.get_subscription_count()
        return bool(named and len(infos) > own and count >= len(infos))

    def _resolved(self, topic: str) -> str:
        return str(self._tuner.node.resolve_topic_name(topic))


class _StoppedError(Exception):
    """The run has ended before its bag."""


def play_clock(
    tuner: TunerNode, topics: dict[str, OwnTopic], listener: Node | None
) -> PlayClock:
    """Make the clock of a run that plays a bag; what it is published on is added to `topics`."""
    publisher = tuner.node.create_publisher(ClockMessage, CLOCK, DEPTH)
    topics[CLOCK] = OwnTopic(publisher, ClockMessage, listener)
    return PlayClock(topics[CLOCK])
