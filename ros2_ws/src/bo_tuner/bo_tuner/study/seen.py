"""What runs: nodes with their parameters, topics with their numbers, services and actions."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace

from bo_tuner.study.descriptors import Described
from bo_tuner.study.nodes import USE_SIM_TIME

JOINT_TRAJECTORY = "trajectory_msgs/msg/JointTrajectory"
JOINTS = ("joints", "joint_names", "dof_names")
"""Names of the parameter in which the controllers of ros2_control have their joints."""


@dataclass(frozen=True)
class SeenNode:
    """A node, as a study names it.

    Attributes
    ----------
    name
        Relative to the namespace.
    parameters
        What it says of its parameters.
    changing
        Names of the parameters that it was seen to change by itself.
    command
        What has started it, so that it takes all parameters at a new start; empty if not known.
    is_estimator
        Whether it is known to be an estimator, whatever its name.
    """

    name: str
    parameters: Mapping[str, Described]
    changing: tuple[str, ...] = ()
    command: str = ""
    is_estimator: bool = False

    @property
    def uses_sim_time(self) -> bool:
        """Whether its time is that of ``/clock``."""
        return USE_SIM_TIME in self.parameters and self.parameters[USE_SIM_TIME].value is True


@dataclass(frozen=True)
class SeenTopic:
    """A topic with numbers.

    Attributes
    ----------
    name, type
        Of the topic, and of its messages.
    fields
        The numbers that can be signals: their value in a message that was heard, by field. For a
        silent topic, the fields of an empty message.
    publishers, listeners
        Names of nodes, one for each publisher or subscription: a node may have several.
    joints
        Those of a trajectory that a controller waits for, in the order of `fields`.
    is_silent
        Whether it has a publisher, and nothing was heard of it.
    """

    name: str
    type: str
    fields: Mapping[str, bool | int | float] = field(hash=False)
    publishers: tuple[str, ...] = ()
    listeners: tuple[str, ...] = ()
    joints: tuple[str, ...] = ()
    is_silent: bool = False

    @property
    def nodes(self) -> tuple[str, ...]:
        """Names of the nodes that publish it, each once."""
        return tuple(dict.fromkeys(self.publishers))


@dataclass(frozen=True)
class SeenAction:
    """An action: its name and type, and the types of a goal's fields by their names."""

    name: str
    type: str
    fields: Mapping[str, str] = field(hash=False)


@dataclass(frozen=True)
class Seen:
    """What runs: nodes with parameters, topics with numbers, services without request, actions.

    Those `together` run in one process, such as a container.
    """

    nodes: tuple[SeenNode, ...]
    topics: tuple[SeenTopic, ...]
    services: tuple[str, ...] = ()
    actions: tuple[SeenAction, ...] = ()
    together: tuple[tuple[str, ...], ...] = ()


def with_joints(
    topic: SeenTopic, nodes: Iterable[SeenNode], topics: Iterable[SeenTopic]
) -> SeenTopic:
    """Fill in the joints of a trajectory that nobody publishes yet, and where they are now.

    They are those in the parameters of the node that listens to it, or else all joints that have a
    published position.
    """
    if topic.type != JOINT_TRAJECTORY or topic.publishers:
        return topic
    positions = {
        name.removeprefix("position[").removesuffix("]"): float(value)
        for other in topics
        for name, value in other.fields.items()
        if name.startswith("position[")
    }
    known = (_joints(node) for node in nodes if node.name in topic.listeners)
    joints = next((names for names in known if names), tuple(positions))
    fields = {
        f"points[0].positions[{i}]": positions.get(joint, 0.0) for i, joint in enumerate(joints)
    }
    return replace(topic, fields=fields, joints=joints)


def _joints(node: SeenNode) -> tuple[str, ...]:
    for key in JOINTS:
        value = node.parameters[key].value if key in node.parameters else None
        if isinstance(value, (list, tuple)):
            return tuple(str(joint) for joint in value)
    return ()
