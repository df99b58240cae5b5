"""Parameters of a node that looks like the plant, by the topics between it and its controller."""

import pytest
from node_threads import at_work
from rclpy.node import Node
from servo import study
from std_msgs.msg import Float64
from waiting import DEADLINE

from bo_tuner.backends.ros import others
from bo_tuner.backends.ros.graph import opened_node
from bo_tuner.backends.ros.plant import plant_notes

pytestmark = pytest.mark.ros

CONTROLLER = ("controller", ("setpoint", "angle"), ("torque",))


def make_node(context, name, heard, published):
    node = Node(name, context=context)
    for topic in heard:
        node.create_subscription(Float64, topic, lambda message: None, 10)
    for topic in published:
        node.create_publisher(Float64, topic, 10)
    return node


@pytest.fixture
def notes(empty_domain):
    """Function that returns what is said of tuned parameters of the last of some nodes."""

    def make(*nodes, names=("inertia",)):
        *first, (tuned, _, _) = nodes
        parameter = {"node": "it", "type": "double", "bounds": [0, 3], "default": 0.5}
        made = study(
            run={"before": [], "start": [{"publish": {"topic": "setpoint", "message": {}}}]},
            nodes={"it": {"node": tuned}},
            parameters=dict.fromkeys(names, parameter),
        )
        with at_work(lambda context: make_node(context, *nodes[-1])) as node:
            rest = [make_node(node.context, *each) for each in first]
            wanted = {name for name, _, _ in nodes}
            with opened_node([], lambda: None) as tuner:
                assert tuner.wait_until(lambda: wanted <= set(others.nodes(tuner.node)), DEADLINE)
                # Topics become known after the node.
                tuner.wait_until(lambda: bool(list(plant_notes(made, tuner))), 1.0)
                found = list(plant_notes(made, tuner))
            for each in rest:
                each.destroy_node()
        return found

    return make


def test_parameters_of_the_plant(notes):
    motor = ("motor", ("torque",), ("angle",))
    assert notes(CONTROLLER, motor, names=("inertia", "kp", "friction")) == [
        "parameters.inertia, parameters.friction: motor looks like the plant of controller; what a "
        "machine cannot choose, such as its inertia, belongs under contexts"
    ]
    assert notes(CONTROLLER, motor, names=("gain",)) == []


@pytest.mark.parametrize(
    "node",
    [
        # A controller and its machine in one, an inner loop, and an estimator.
        ("servo", ("setpoint",), ("angle",)),
        ("inner", ("torque", "current"), ("angle",)),
        ("estimator", ("torque", "measured"), ("angle",)),
        ("filter", ("torque",), ("smooth",)),
    ],
)
def test_nodes_that_are_not_the_plant(notes, node):
    motor = ("motor", ("voltage",), ("current", "measured"))
    assert notes(CONTROLLER, motor, node) == []
