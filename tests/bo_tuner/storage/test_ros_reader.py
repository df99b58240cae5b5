"""Parameter files as ROS reads them; tests/ros compares with ROS itself."""

import json
import math
from pathlib import Path

import pytest

from bo_tuner.errors import StudyError
from bo_tuner.storage.ros_reader import read_sections
from bo_tuner.storage.ros_sections import full_names, sources
from bo_tuner.storage.ros_values import read_value

FILES = Path(__file__).parent / "parameter_files"
EXPECTED = json.loads((FILES / "expected.json").read_text())


def read(text, node="/pid"):
    return {name: s.written.value for name, s in sources(read_sections(text), node).items()}


def of_pid(*lines):
    return "\n".join(["pid:", "  ros__parameters:", *(f"    {line}" for line in lines)]) + "\n"


@pytest.mark.parametrize(
    "case", EXPECTED, ids=lambda c: f"{c['file']}-{c['namespace']}-{c['node']}"
)
def test_files_in_the_layouts_of_the_field(case):
    text = (FILES / case["file"]).read_text()
    if case["ros_reads"] == {"refused": True}:
        with pytest.raises(StudyError) as caught:
            read_sections(text)
        assert caught.value.line
        return
    node = f"{case['namespace'].rstrip('/')}/{case['node']}"
    assert sorted(map(repr, read(text, node).items())) == sorted(
        map(repr, case["ros_reads"].items())
    )


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("1", 1), ("1.0", 1.0), ("010", 8), ("08", 8.0), ("0x1F", 31), ("-0x10", -16), ("+5", 5),
        ("1e1", 10.0), ("1.e-3", 0.001), (".5", 0.5), ("0x1p3", 8.0), ("1_000", "1_000"),
        ("0b1", "0b1"), ("1:30", "1:30"), ("9223372036854775808", 2.0**63), ("1e400", "1e400"),
        ("yes", True), ("on", True), ("Off", False), ("N", False), ("yEs", "yEs"),
        ("~", "~"), ("null", "null"), (".inf", math.inf), ("-.INF", -math.inf),
        ("inf", math.inf), ("Infinity", math.inf), ("+.nan", "+.nan"), ("2001-01-01", "2001-01-01"),
    ],
)  # fmt: skip
def test_plain_values(text, value):
    assert repr(read_value(text)) == repr(value)
    assert read_value(text, "'") == read_value(text, tag="tag:yaml.org,2002:str") == text


def test_not_a_number():
    assert math.isnan(read_value(".nan"))
    assert math.isnan(read_value("nan"))


@pytest.mark.parametrize(
    ("key", "nodes"),
    [
        ("pid", {"/pid"}),
        ("/**", {"/pid", "/arm/pid", "/arm/left/pid", "/arm"}),
        ("/*", {"/pid", "/arm"}),
        ("/*/pid", {"/arm/pid"}),
        ("/**/pid", {"/pid", "/arm/pid", "/arm/left/pid"}),
        ("/arm/*", {"/arm/pid"}),
        ("/arm/**", {"/arm/pid", "/arm/left/pid", "/arm"}),
        ("arm/left/pid", {"/arm/left/pid"}),
    ],
)
def test_wildcards(key, nodes):
    (section,) = read_sections(f"{key}:\n  ros__parameters: {{kp: 1.0}}\n")
    every = ("/pid", "/arm/pid", "/arm/left/pid", "/arm")
    assert {node for node in every if section.is_of(node)} == nodes


class TestWhichValueCounts:
    def test_the_section_that_comes_last(self):
        one, other = "pid: {ros__parameters: {kp: 2.0}}\n", "/**: {ros__parameters: {kp: 9.0}}\n"
        assert read(one + other) == {"kp": 9.0}
        assert read(other + one) == {"kp": 2.0}

    def test_a_section_that_is_repeated_stays_in_its_place(self):
        text = "pid: {ros__parameters: {kp: 1.0}}\n/**: {ros__parameters: {kp: 9.0}}\n"
        assert read(text + "pid: {ros__parameters: {kp: 2.0, ki: 3.0}}\n") == {"kp": 9.0, "ki": 3.0}

    def test_nested_names_of_nodes_and_parameters(self):
        text = "arm:\n  left: {pid: {ros__parameters: {gains: {p: 1, d.x: 2}}}}\n  pid:\n"
        text += "    ros__parameters: {gains.p: 3}\n"
        assert read(text, "/arm/left/pid") == {"gains.p": 1, "gains.d.x": 2}
        assert read(text, "/arm/pid") == {"gains.p": 3}

    def test_a_wildcard_with_the_name_of_a_node_below(self):
        assert read("/**:\n  pid: {ros__parameters: {kp: 1.0}}\n", "/arm/pid") == {"kp": 1.0}

    def test_a_dot_in_the_name_of_a_level(self):
        """Of which ROS leaves only the part behind the dot."""
        assert read(of_pid("gains:", "  joint.1: {p: 1}", "  k: 2")) == {
            "gains.joint.1.p": 1,
            "gains.joint.k": 2,
        }

    def test_an_integer_counts_before_a_double_that_was_given_later(self):
        assert read(of_pid("kp: 1") + "arm: {ros__parameters: {a: 1}}\n" + of_pid("kp: 2.0")) == {
            "kp": 1
        }

    def test_a_list_without_an_item_and_text_with_a_tag(self):
        assert read(of_pid("a: []", "b: !!str 5", "c: '5'")) == {"a": [], "b": "5", "c": "5"}


@pytest.mark.parametrize(
    ("text", "problem", "line"),
    [
        (of_pid("a: &a 1", "b: *a"), "aliases", 4),
        (of_pid("a: [1, 2.0]"), "several types", 3),
        (of_pid("a: 1", "b:"), "without a value", 4),
        (of_pid("a: [http://x]"), "needs quotes", 3),
        (of_pid("a: [1"), "not valid YAML", 4),
        ("pid:\n  kp: 1.0\n", "ahead of ros__parameters", 2),
        ("ros__parameters: {kp: 1.0}\n", "no name of a node", 1),
        ("<robot>:\n  ros__parameters: {kp: 1.0}\n", "'<robot>' is no name of a node", 2),
        ("arm/1x/pid:\n  ros__parameters: {kp: 1.0}\n", "is no name of a node", 2),
        ("//pid:\n  ros__parameters: {kp: 1.0}\n", "is no name of a node", 2),
        ("pid: [ros__parameters]\n", "a list ahead of ros__parameters", 1),
        ("[pid]: {ros__parameters: {kp: 1.0}}\n", "a list cannot be a key", 1),
        ("- 1\n", "a list cannot be a key", 1),
        ("pid:\n  ros__parameters: 7\n", "ahead of ros__parameters", 2),
    ],
)
def test_what_ros_refuses_is_refused_with_its_line(text, problem, line):
    with pytest.raises(StudyError, match=problem) as caught:
        read_sections(text)
    assert caught.value.line == line


def test_the_place_of_a_value_is_that_of_its_text():
    text = "é: {ros__parameters: {}}\n".replace("é", "axis") + of_pid(
        "a: &here 'it''s'", "b: [ 1.5,  2.5 ]  # ö", "c: !!str  on", "d: µm", 'e: "x"'
    )
    found = sources(read_sections(text), "/pid")
    places = {n: [text[i.start : i.end] for i in s.written.items] for n, s in found.items()}
    assert places == {
        "a": ["'it''s'"], "b": ["1.5", "2.5"], "c": ["on"], "d": ["µm"], "e": ['"x"'],
    }  # fmt: skip
    start, end = found["b"].written.span
    assert text[start:end] == "[ 1.5,  2.5 ]"
    assert found["d"].line == 7


def test_a_node_without_a_namespace_counts_in_that_of_the_file():
    sections = read_sections("cell: {axis: {ros__parameters: {gain: 1.0}}}\n")
    assert full_names(sections, "axis") == ["/cell/axis"]
    assert full_names(sections, "axis", "/hall") == ["/hall/axis"]
    assert full_names(sections, "/axis", "/hall") == ["/axis"]
    assert full_names(sections, "/axis") == ["/axis"]
    sections = read_sections(
        "cell: {axis: {ros__parameters: {a: 1}}}\n/**: {ros__parameters: {a: 2}}"
    )
    assert full_names(sections, "axis") == ["/axis"]
