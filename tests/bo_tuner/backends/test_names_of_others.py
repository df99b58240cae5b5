"""What is said of nodes that are not there."""

from types import SimpleNamespace

import pytest

from bo_tuner.backends.ros import others
from bo_tuner.backends.ros.errors import SilentError
from bo_tuner.backends.ros.presence import Presence


def graph(*names):
    """A node that sees those of the tuner itself, and others in its namespace."""
    found = [(name, "/") for name in ("bo_tuner", "bo_tuner_signals", "tuner", *names)]
    return SimpleNamespace(
        get_namespace=lambda: "/",
        get_node_names_and_namespaces=lambda: found,
        context=SimpleNamespace(get_domain_id=lambda: 7),
        count_publishers=lambda topic: 1,
    )


@pytest.mark.parametrize(
    ("there", "said"),
    [
        (["motor"], "/pid: no such node in ROS domain 7; expected one of motor"),
        (["motor", "pid2"], "/pid: no such node in ROS domain 7; did you mean 'pid2'?"),
        ([], "/pid: no such node in ROS domain 7; no other node runs there: start yours"),
    ],
)
def test_the_tuner_s_own_nodes_are_not_offered(there, said):
    assert others.absent(["pid"], graph(*there)).removeprefix("/").startswith(said[1:])


class Client:
    """Of a node that is there, or is not, and answers, or does not."""

    def __init__(self, ready=True, silent=False):
        self.ready, self.silent = ready, silent

    def is_ready(self):
        return self.ready

    def expect_answers(self, deadline):
        if self.silent:
            raise SilentError("it does not answer")


def test_who_is_waited_for():
    clients = {"gone": Client(ready=False), "dead": Client(silent=True), "well": Client()}
    nodes = {key: SimpleNamespace(node=key, result="") for key in clients}
    presence = Presence(
        SimpleNamespace(nodes=nodes, trigger=None),
        SimpleNamespace(node=graph(*clients)),
        SimpleNamespace(clients=clients),
        None,
    )
    assert presence.missing() == ["gone", "dead"]
