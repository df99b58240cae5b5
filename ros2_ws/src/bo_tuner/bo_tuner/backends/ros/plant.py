"""Which nodes of a study may be the plant, by the topics between them."""

from collections.abc import Iterator

from rclpy.node import Node

from bo_tuner.backends.ros.others import OF_ROS, is_hidden
from bo_tuner.backends.ros.tuner_node import TunerNode, full_name, is_own
from bo_tuner.study.parameter_kinds import Kind, kinds
from bo_tuner.study.study import Study

Ends = dict[str, set[str]]
"""Topics by the full name of a node."""


def plant_notes(study: Study, tuner: TunerNode) -> Iterator[str]:
    """Yield a line for each node that may be the plant and has parameters that are tuned.

    It hears only what a controller of the run's reference publishes, and publishes what that
    controller hears. An estimator hears the plant, too, and a controller the reference.
    Parameters that are named for tuning, such as a gain, are none of the plant's.
    """
    if study.run is None:
        return
    published, heard = _ends(tuner.node)
    name = tuner.node.resolve_topic_name
    steps = (*study.run.before, *study.run.start)
    references = {name(step.publish.topic) for step in steps if step.publish is not None}
    controllers = {node for node, topics in heard.items() if topics & references}
    for key, spec in study.nodes.items():
        node = full_name(tuner.node.get_namespace(), spec.node)
        tuned = {
            name: item.parameter
            for name, item in study.parameters.items()
            if item.node == key and item.is_tuned
        }
        kind_of = kinds(spec.node, dict.fromkeys(tuned.values(), ""))
        names = [
            f"parameters.{name}"
            for name, parameter in tuned.items()
            if kind_of[parameter] is not Kind.TUNING
        ]
        if not names or node in controllers:
            continue
        others = (topics for other, topics in published.items() if other != node)
        inputs = heard.get(node, set()) & set().union(*others)
        for controller in sorted(controllers):
            commands = inputs & published.get(controller, set())
            answers = published.get(node, set()) & heard[controller]
            if commands == inputs and commands and answers:
                yield (
                    f"{', '.join(names)}: {spec.node} looks like the plant of "
                    f"{controller.removeprefix('/')}; what a machine cannot choose, such as its "
                    "inertia, belongs under contexts"
                )


def _ends(node: Node) -> tuple[Ends, Ends]:
    """Return what the nodes of others publish, and what they hear."""
    published: Ends = {}
    heard: Ends = {}
    for name, namespace in node.get_node_names_and_namespaces():
        if is_own(name) or is_hidden(name):
            continue
        full = full_name(namespace, name)
        # One that leaves in this moment has no topics.
        try:
            publishers = node.get_publisher_names_and_types_by_node(name, namespace)
            listeners = node.get_subscriber_names_and_types_by_node(name, namespace)
        except RuntimeError:
            continue
        for ends, named_types in ((published, publishers), (heard, listeners)):
            topics = {
                topic for topic, _ in named_types if topic not in OF_ROS and not is_hidden(topic)
            }
            ends.setdefault(full, set()).update(topics)
    return published, heard
