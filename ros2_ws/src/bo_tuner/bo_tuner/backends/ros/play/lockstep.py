"""Waits until nodes are done with the messages that they were sent."""

import threading
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator

from rcl_interfaces.srv import GetParameters
from rclpy.client import Client
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node

from bo_tuner.backends.ros import others
from bo_tuner.backends.ros.clock import TOPIC as CLOCK
from bo_tuner.backends.ros.errors import LostError
from bo_tuner.backends.ros.heard_topic import weakest
from bo_tuner.backends.ros.messages import interface_class
from bo_tuner.backends.ros.publication import CONNECT_TIMEOUT
from bo_tuner.backends.ros.tuner_node import (
    NODE_NAME,
    POLL_PERIOD,
    UNKNOWN_NODE,
    TunerNode,
    full_name,
)
from bo_tuner.errors import StudyError
from bo_tuner.study.playing import Answer

QUESTION = GetParameters.Request(names=["use_sim_time"])


class StoppedError(Exception):
    """The run has ended before its bag."""


class Lockstep:
    """What nodes are waited for, and how.

    A node is done with a message when it answers a question on its parameters: that comes after
    the message, on the same way, and a node with one thread works on it after the message. What
    the node has published meanwhile has come by then, too.

    `settle` is for the thread that plays; the others are for that of the tuner, ahead of it.

    Attributes
    ----------
    latest
        The latest message on each topic that is heard.
    settled
        Numbers of messages, by their topic, since the beginning.
    answered
        Of how many of these, by their topic and one that is heard, something came on the latter.
    """

    def __init__(self, tuner: TunerNode, stopped: threading.Event) -> None:
        self._tuner = tuner
        self._stopped = stopped
        self._node = Node(
            f"{NODE_NAME}_player",
            context=tuner.context,
            enable_rosout=False,
            start_parameter_services=False,
        )
        self._executor = SingleThreadedExecutor(context=tuner.context)
        self._executor.add_node(self._node)
        self._questions: dict[str, Client] = {}
        self._counts: dict[str, int] = {}
        self.latest: dict[str, bytes] = {}
        self.settled: Counter[str] = Counter()
        self.answered: Counter[tuple[str, str]] = Counter()
        self._followers: dict[str, list[str]] = {}
        self._answers: dict[str, Answer] = {}

    def hear(self, topic: str) -> None:
        """Count the answers on a topic."""
        if topic in self._counts:
            return
        node = self._tuner.node

        def is_offered() -> bool:
            return bool(others.publishers(node, topic))

        if not self._tuner.wait_until(is_offered, CONNECT_TIMEOUT):
            raise StudyError(f"nothing publishes {topic}", ("topic",))
        infos = others.publishers(node, topic)

        def count(message: bytes) -> None:
            self._counts[topic] += 1
            self.latest[topic] = message

        self._counts[topic] = 0
        cls, qos = interface_class(infos[0].topic_type), weakest([i.qos_profile for i in infos])
        self._node.create_subscription(cls, topic, count, qos, raw=True)

    def begin(self, topics: Iterable[str], answers: dict[str, Answer]) -> None:
        """Find the nodes that hear some topics, of which some are answered by messages."""
        followers = {topic: list(self._hearing(topic)) for topic in topics if topic not in answers}
        nodes = {name for names in followers.values() for name in names}
        followers[CLOCK] = [name for name in self._hearing(CLOCK) if name in nodes]
        for topic, names in followers.items():
            for name in names:
                self._expect_service(name, topic)
        self._followers, self._answers = followers, answers
        before = -1
        while before != (now := sum(self._counts.values())):
            # What has come since the last run.
            before = now
            self._executor.spin_once(timeout_sec=POLL_PERIOD)
        self._counts = dict.fromkeys(self._counts, 0)
        self.settled.clear()
        self.answered.clear()

    def settle(self, topic: str, timeout: float) -> None:
        """Wait until nodes are done with a message on a topic."""
        before = dict(self._counts)
        self.settled[topic] += 1
        if topic in self._answers:
            self._settle_by_answer(topic, self._answers[topic], timeout)
        else:
            self._settle_by_question(topic, timeout)
        came = [heard for heard, count in self._counts.items() if count > before[heard]]
        self.answered.update((topic, heard) for heard in came)

    def close(self) -> None:
        """Leave ROS."""
        self._executor.shutdown()
        self._node.destroy_node()

    def _settle_by_question(self, topic: str, timeout: float) -> None:
        asked = [(name, self._questions[name]) for name in self._followers[topic]]
        answers = [(name, client, client.call_async(QUESTION)) for name, client in asked]
        try:
            for name, _, answer in answers:
                self._spin_until(answer.done, f"{name} does not answer", timeout)
        finally:
            for _, client, answer in answers:
                client.remove_pending_request(answer)

    def _settle_by_answer(self, topic: str, answer: Answer, timeout: float) -> None:
        sent = self.settled[topic]
        problem = f"no answer on {answer.topic} to message {sent} of {topic}"
        due = sent // answer.every
        self._spin_until(lambda: self._counts[answer.topic] >= due, problem, timeout)

    def _spin_until(self, condition: Callable[[], bool], problem: str, timeout: float) -> None:
        deadline = time.monotonic() + timeout
        while not condition():
            if self._stopped.is_set():
                raise StoppedError
            if time.monotonic() > deadline:
                raise LostError(f"{problem} within {timeout:g} s")
            self._executor.spin_once(timeout_sec=POLL_PERIOD)

    def _hearing(self, topic: str) -> Iterator[str]:
        for info in others.subscribers(self._tuner.node, topic):
            if info.node_name != UNKNOWN_NODE:
                yield full_name(info.node_namespace, info.node_name)

    def _expect_service(self, name: str, topic: str) -> None:
        if name not in self._questions:
            service = f"{name}/get_parameters"
            self._questions[name] = self._node.create_client(GetParameters, service)
        ready = self._questions[name].service_is_ready
        if not self._tuner.wait_until(ready, CONNECT_TIMEOUT):
            raise StudyError(
                f"{name} has no parameter services, which tell that it is done with a message; say "
                f"in answers on which topic it answers {topic}, or put lockstep: false",
                ("run", "start", 0, "play", "lockstep"),
            )
