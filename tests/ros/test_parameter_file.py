"""A parameter file as a node reads it at its start."""

import pytest
import rclpy
from hypothesis import given, settings
from hypothesis import strategies as st
from rclpy.node import Node

from bo_tuner.errors import StudyError
from bo_tuner.storage.parameter_file import to_yaml
from bo_tuner.storage.ros_reader import read_sections
from bo_tuner.storage.ros_sections import sources

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


SINGLE = st.sampled_from(
    [
        "1", "2.0", "010", "08", "0x1F", "-0x10", "1e1", "1.e-3", ".5", "1e400", "1_000", "0b1",
        "9223372036854775808", "nan", ".inf", "-.INF", "yes", "On", "off", "~", "null", "text",
        "a:b", "'a b'", '"1"', "!!str 5", "&x 3", "*x", "{}", "[]", "[1, 2]", "[1.0, .5]",
        "[a, 'b']", "[yes, no]", "[1, 2.0]", "[[1], [2]]", "[{a: 1}, {a: 2}]", "[a:b]",
        "{p: 1, d: 2.0}", "{a.b: {c: 1}, d: 2}", "",
    ]
)  # fmt: skip
KEY = st.sampled_from(["kp", "ki", "gains", "a.b", "joint.1", "7", "/x", "'q r'", "a"])
LEVEL = st.sampled_from(
    [
        "pid", "/pid", "/**", "/*", "/*/pid", "/**/pid", "arm", "/arm", "/arm/**", "arm/pid",
        "left", "/arm/left", "*", "/arm/*", "1x", "x-y",
    ]
)  # fmt: skip
PARAMETERS = st.recursive(
    SINGLE,
    lambda below: st.lists(st.tuples(KEY, below), min_size=1, max_size=4),
    max_leaves=8,
)
SECTION_OF_NODE = st.tuples(
    st.just("ros__parameters"), st.lists(st.tuples(KEY, PARAMETERS), min_size=1, max_size=4)
)
NODES = st.recursive(
    st.lists(SECTION_OF_NODE, min_size=1, max_size=1),
    lambda below: st.lists(st.tuples(LEVEL, below), min_size=1, max_size=3),
    max_leaves=4,
)
FILES = st.lists(st.tuples(LEVEL, NODES), min_size=1, max_size=4)


def written(levels, indent=""):
    lines = []
    for key, below in levels:
        if isinstance(below, str):
            lines.append(f"{indent}{key}: {below}")
        else:
            lines += [f"{indent}{key}:", *written(below, indent + "  ")]
    return lines


def of_ros(path, nodes):
    """What rclpy gives nodes that start with a file; None if it refuses the file."""
    context = rclpy.Context()
    try:
        rclpy.init(args=["--ros-args", "--params-file", str(path)], context=context)
    except Exception:  # of a class that is not public
        return None
    found = {}
    try:
        for node in nodes:
            namespace, _, name = node.rpartition("/")
            made = Node(
                name,
                namespace=namespace or "/",
                context=context,
                start_parameter_services=False,
                enable_rosout=False,
            )
            overrides = made._parameter_overrides.items()
            # A list without an item has no type, so no value.
            found[node] = {k: plain(p.value) for k, p in overrides if p.value is not None}
            made.destroy_node()
    finally:
        context.try_shutdown()
    return found


def plain(value):
    return value if isinstance(value, (str, bool, int, float)) else list(value)


def of_ours(text, nodes):
    try:
        sections = read_sections(text)
    except StudyError:
        return None
    return {
        node: {
            k: s.written.value for k, s in sources(sections, node).items() if s.written.value != []
        }
        for node in nodes
    }


def in_order(found):
    return None if found is None else {n: sorted(map(repr, v.items())) for n, v in found.items()}


@settings(max_examples=300)
@given(FILES)
def test_any_file_is_read_as_ros_reads_it(tmp_path_factory, levels):
    path = tmp_path_factory.getbasetemp() / "any.yaml"
    text = "\n".join(written(levels)) + "\n"
    path.write_text(text)
    nodes = ("/pid", "/arm/pid", "/arm/left/pid", "/arm")
    assert in_order(of_ours(text, nodes)) == in_order(of_ros(path, nodes)), text
