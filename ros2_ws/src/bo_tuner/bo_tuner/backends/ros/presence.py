"""Which of a study's nodes are there, were started anew, or run more than once."""

import time
from collections.abc import Mapping

from rclpy.client import Client
from rclpy.expand_topic_name import expand_topic_name

from bo_tuner.backends.ros import others
from bo_tuner.backends.ros.errors import LostError
from bo_tuner.backends.ros.parameters.events import PARAMETER_EVENTS
from bo_tuner.backends.ros.parameters.nodes import NodeParameters
from bo_tuner.backends.ros.parameters.services import meet
from bo_tuner.backends.ros.publishers import NAME_TIMEOUT
from bo_tuner.backends.ros.trigger import of_node
from bo_tuner.backends.ros.tuner_node import NODE_NAME, UNKNOWN_NODE, TunerNode, full_name
from bo_tuner.study.study import Study


class Presence:
    """What the graph shows of the nodes of a study."""

    def __init__(
        self, study: Study, tuner: TunerNode, parameters: NodeParameters, trigger: Client | None
    ) -> None:
        self._study = study
        self._tuner = tuner
        self._node = tuner.node
        self._parameters = parameters
        self._trigger = trigger
        self._publishers: dict[str, set[bytes]] = {}
        self._anonymous: set[bytes] = set()
        self._twins: list[str] = []

    def absent(self) -> list[str]:
        """Return the study's keys of the nodes that are not discovered, or not in full."""
        triggered = self._study.trigger.node if self._study.trigger else None
        return [
            key
            for key in self._study.nodes
            if not self._parameters.clients[key].is_ready()
            or self._node.count_publishers(self._sign_of_life(key)) == 0
            or (key == triggered and self._trigger and not self._trigger.service_is_ready())
        ]

    def missing(self) -> list[str]:
        """Return the keys of nodes that are `absent`, or do not answer: one may just have died."""
        keys = self.absent()
        for key, client in self._parameters.clients.items():
            if key not in keys:
                try:
                    client.expect_answers(time.monotonic())
                except LostError:
                    keys.append(key)
        return keys

    def wait_for_nodes(self, timeouts: Mapping[str, float]) -> list[str]:
        """Wait until every node is discovered and answers."""
        begun = time.monotonic()
        while absent := self.absent():
            late = [key for key in absent if time.monotonic() > begun + timeouts[key]]
            if late:
                names = [self._study.nodes[key].node for key in late]
                # It may be the tuner that has started them.
                raise LostError(others.absent(names, self._node, start=""))
            self._tuner.spin_once()
        for key, client in self._parameters.clients.items():
            client.expect_answers(begun + timeouts[key])
            self.meet(key, begun + timeouts[key])
        return self.restarted()

    def meet(self, key: str, deadline: float) -> None:
        """Wait until a node sends to all of the tuner's subscriptions so far."""
        meet(self._tuner, self._study.nodes[key].node, deadline)

    def wait_until_gone(self, timeout: float) -> None:
        """Wait until no node of the study is discovered any more, at most `timeout` seconds."""
        deadline = time.monotonic() + timeout
        while len(self.absent()) < len(self._study.nodes) and time.monotonic() < deadline:
            self._tuner.spin_once()

    def restarted(self) -> list[str]:
        """Return the keys of nodes that were started anew since this was last asked.

        Such a node has forgotten its parameters, which are to be set again.
        """
        self._wait_for_names()
        keys = []
        for key in self._study.nodes:
            present = self._publishers_of(key)
            # One that was killed stays in the graph for a while; what counts is what is new.
            if present - self._publishers.get(key, set()):
                keys.append(key)
            self._publishers[key] = present
        return keys

    def twins(self, timeout: float) -> str:
        """Return a line on nodes that run more than once; empty if none does.

        A node that was killed and is back counts twice until its lease ends, which is waited for at
        most `timeout` seconds, and once only.
        """
        deadline = time.monotonic() + timeout
        while twins := self._repeated():
            if time.monotonic() > deadline or twins == self._twins:
                self._twins = twins
                return self._tuner.repeated(twins[0])
            self._tuner.spin_once()
        self._twins = []
        return ""

    def _repeated(self) -> list[str]:
        """Name the nodes and services that more than one process gives."""
        names = [
            spec.node
            for key, spec in self._study.nodes.items()
            if self._parameters.clients[key].servers() > 1
        ]
        if self._trigger and self._node.count_services(self._trigger.srv_name) > 1:
            names.append(self._trigger.srv_name)
        return names

    def _publishers_of(self, key: str) -> set[bytes]:
        """Find the publishers of a node's sign of life that the graph says are of the node."""
        name = expand_topic_name(self._study.nodes[key].node, NODE_NAME, self._node.get_namespace())
        infos = self._node.get_publishers_info_by_topic(self._sign_of_life(key))
        return {
            bytes(info.endpoint_gid)
            for info in infos
            if full_name(info.node_namespace, info.node_name) == name
        }

    def _wait_for_names(self) -> None:
        """Wait until the graph has the node of each new sign of life."""
        deadline = time.monotonic() + NAME_TIMEOUT
        while nameless := self._nameless() - self._anonymous:
            if time.monotonic() > deadline:
                # Not of a ROS node, or else it is noticed once it has a name.
                self._anonymous |= nameless
                return
            self._tuner.spin_once()

    def _nameless(self) -> set[bytes]:
        topics = {self._sign_of_life(key) for key in self._study.nodes}
        infos = [i for topic in topics for i in self._node.get_publishers_info_by_topic(topic)]
        return {bytes(info.endpoint_gid) for info in infos if info.node_name == UNKNOWN_NODE}

    def _sign_of_life(self, key: str) -> str:
        """Topic on which a node has a publisher from its start on, and anew when it restarts."""
        spec = self._study.nodes[key]
        return of_node(spec.node, spec.result) if spec.result else PARAMETER_EVENTS
