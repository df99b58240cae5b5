"""A parameter file as a node reads it at its start."""

import pytest
import rclpy
from rclpy.node import Node

from bo_tuner.storage.parameter_file import to_yaml

pytestmark = pytest.mark.ros

VALUES = {
    "servo": {
        "axis": "y",
        "no": "N",
        "power": "1e5",
        "none": "nan",
        "octal": "08",
        "empty": "",
        "quoted": 'it\'s "so"',
        "axes": ["x", "y"],
        "gain": 1.0,
        "on": True,
        "count": 3,
        "weights": [1.0, 2.5],
    }
}


def test_it_has_each_value_with_its_type(ros_environment, tmp_path):
    """ROS takes a plain `y` for true, and much else for a number."""
    path = tmp_path / "best.yaml"
    path.write_text(to_yaml(VALUES))
    context = rclpy.Context()
    rclpy.init(args=["--ros-args", "--params-file", str(path)], context=context)
    try:
        node = Node("servo", context=context, automatically_declare_parameters_from_overrides=True)
        found = {name: node.get_parameter(name).value for name in VALUES["servo"]}
        node.destroy_node()
    finally:
        context.try_shutdown()
    plain = {
        n: list(v) if not isinstance(v, (str, bool, int, float)) else v for n, v in found.items()
    }
    assert repr(plain) == repr(VALUES["servo"])
