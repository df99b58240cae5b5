"""What others have in the graph, to be offered in place of a name that is not there."""

from collections.abc import Collection, Iterable, Sequence

from rclpy.node import Node
from rclpy.topic_endpoint_info import TopicEndpointInfo

from bo_tuner.backends.ros.tuner_node import LIVE_NODE, full_name, is_own
from bo_tuner.codec import checks

OF_ROS = ("/rosout", "/parameter_events", "/clock")
"""Topics that ROS itself uses."""
OF_EVERY_NODE = (
    "describe_parameters",
    "get_parameter_types",
    "get_parameters",
    "get_type_description",
    "list_parameters",
    "set_parameters",
    "set_parameters_atomically",
)
"""Services that nodes have for their parameters and types."""


START = "start yours, or set their ROS_DOMAIN_ID"
"""What to do where no other node runs, unless the tuner was to start it."""


def is_hidden(name: str) -> bool:
    """Whether a name is not meant to be seen: a part of it begins with an underscore."""
    return any(part.startswith("_") for part in name.split("/"))


def relative(node: Node, name: str, namespace: str) -> str:
    """Return a name relative to the namespace of `node`; empty if it is in another one."""
    own = node.get_namespace().rstrip("/") + "/"
    full = full_name(namespace, name)
    return full.removeprefix(own) if full.startswith(own) else ""


def nodes(node: Node) -> list[str]:
    """Return the names of other nodes than the tuner's own, as a study has them.

    They are relative to the namespace of `node`; of what is in another one the name is in full.
    """
    return _others(
        relative(node, name, namespace) or full_name(namespace, name)
        for name, namespace in node.get_node_names_and_namespaces()
    )


def running(names: Iterable[str], node: Node) -> list[str]:
    """Return which of some nodes run, by their names as a study has them."""
    there = {full_name(space, name) for name, space in node.get_node_names_and_namespaces()}
    return [name for name in names if full_name(node.get_namespace(), name) in there]


def absent(missing: Sequence[str], node: Node, start: str = f": {START}") -> str:
    """Tell in a line which nodes are not there, and which one was meant."""
    namespace = node.get_namespace().rstrip("/")
    known = nodes(node)
    there = running(missing, node)
    gone = [name for name in missing if name not in there]
    names = " and ".join(
        full_name(namespace, name) if namespace else name for name in gone or missing
    )
    if not gone:
        return f"{names}: found, but not with all services and topics that are needed"
    what = "no such nodes" if gone[1:] else "no such node"
    near = checks.suggestion(gone[0], known) if known else f"no other node runs there{start}"
    return f"{names}: {what} in ROS domain {node.context.get_domain_id()}; {near}"


def topics(node: Node) -> list[str]:
    """Return the topics of others."""
    return _others(name for name, _ in node.get_topic_names_and_types() if name not in OF_ROS)


def publishers(node: Node, topic: str) -> list[TopicEndpointInfo]:
    """Return who publishes a topic but the tuner's own nodes."""
    infos = node.get_publishers_info_by_topic(topic)
    return [info for info in infos if not is_own(info.node_name)]


def subscribers(node: Node, topic: str) -> list[TopicEndpointInfo]:
    """Return who subscribes to a topic but the tuner's own nodes, which may record it."""
    infos = node.get_subscriptions_info_by_topic(topic)
    return [info for info in infos if not is_own(info.node_name)]


def services(node: Node) -> list[str]:
    """Return the services of others that somebody serves, but for those of every node."""
    return _others(
        name
        for name, _ in node.get_service_names_and_types()
        if name.rpartition("/")[2] not in OF_EVERY_NODE and node.count_services(name)
    )


def instead(value: str, names: Collection[str], node: Node) -> str:
    """Return what to do about a name that is not there: the one that was meant, or how to start."""
    others = [name for name in names if name != value]
    if others or nodes(node):
        return checks.suggestion(value, others)
    domain = node.context.get_domain_id()
    return f"no other node runs in ROS domain {domain}: {START}"


def _others(names: Iterable[str]) -> list[str]:
    return sorted(
        {
            name
            for name in names
            if not is_hidden(name)
            and not any(is_own(part) or part == LIVE_NODE for part in name.split("/"))
        }
    )
