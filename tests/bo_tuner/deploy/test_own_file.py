"""Values in a user's own parameter file: what changes in its text, and what ROS reads then."""

import difflib
import json
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bo_tuner.deploy.own_file import with_values
from bo_tuner.errors import StudyError
from bo_tuner.storage.ros_reader import read_sections
from bo_tuner.storage.ros_sections import sources

FILES = Path(__file__).parents[1] / "storage" / "parameter_files"
EXPECTED = [
    case
    for case in json.loads((FILES / "expected.json").read_text())
    if case["ros_reads"] != {"refused": True}
]


def read(text, node):
    return {name: s.written.value for name, s in sources(read_sections(text), node).items()}


def full_name(case):
    return f"{case['namespace'].rstrip('/')}/{case['node']}"


def changed_lines(old, new):
    lines = difflib.ndiff(old.splitlines(), new.splitlines())
    return [line for line in lines if line[0] in "+-"]


def other(value):
    """Another value of the same type."""
    if isinstance(value, list):
        return [other(value[0]), *value[1:]]
    if isinstance(value, bool):
        return not value
    return f"{value} it's" if isinstance(value, str) else value / 2 + 1 if value * 0 == 0 else 2.5


@pytest.mark.parametrize(
    "case", EXPECTED, ids=lambda c: f"{c['file']}-{c['namespace']}-{c['node']}"
)
def test_a_node_reads_every_new_value_and_all_others_what_they_had(case):
    text, node = (FILES / case["file"]).read_text(), full_name(case)
    old = read(text, node)
    new = {n: other(v) if not isinstance(v, int) else v + (v is not True) for n, v in old.items()}
    for name in ("FollowPath.critics.name.name",):
        new.pop(name, None)
    edited = with_values(text, {node: new})
    assert repr(sorted(read(edited, node).items())) == repr(sorted((old | new).items()))
    for else_ in ("/else", "/arm/else", "/arm/pid", "/arm/left/pid", *map(full_name, EXPECTED)):
        if else_ != node:
            assert repr(read(edited, else_)) == repr(read(text, else_))
    # All of the file is still there, but for values.
    comments = [line.partition("#")[1:] for line in text.splitlines() if "#" in line]
    assert [ln.partition("#")[1:] for ln in edited.splitlines() if "#" in ln] == comments


OWN = """\
# Gains of the arm
pid:   # the node
  ros__parameters:
    kp:   2        # integer where the node has a double
    ki: &ki 0.10
    gains: {joint1: {p: 600., d: 30.},  joint2: {p: 1e1}}
    mode: "fast"
    style: 'it''s'
    plain: slow
    enabled: yes
    debug: False
    limits:
      - 1.0   # lower
      - 2.0   # upper
    names: [a, b]


# the end
"""


@pytest.mark.parametrize(
    ("name", "value", "old", "new"),
    [
        ("kp", 2.0, "kp:   2  ", "kp:   2.0  "),
        ("ki", 1e-5, "&ki 0.10", "&ki 1.0e-05"),
        ("gains.joint1.p", 550.5, "{p: 600.,", "{p: 550.5,"),
        ("gains.joint2.p", float("inf"), "{p: 1e1}", "{p: .inf}"),
        ("mode", "slow", '"fast"', '"slow"'),
        ("style", "that's", "'it''s'", "'that''s'"),
        ("plain", "fast", "slow", "fast"),
        ("plain", "on", "slow", "'on'"),
        ("plain", "a: b", "slow", "'a: b'"),
        ("enabled", False, "yes", "no"),
        ("debug", True, "False", "True"),
        ("limits", (1.0, 3.5), "- 2.0   #", "- 3.5   #"),
        ("names", ("a", "c"), "[a, b]", "[a, c]"),
        ("names", ("a",), "[a, b]", "[a]"),
    ],
)
def test_only_the_value_changes(name, value, old, new):
    assert with_values(OWN, {"/pid": {name: value}}) == OWN.replace(old, new, 1)


def test_what_is_as_it_shall_be_stays_as_it_is_written():
    values = {"kp": 2, "ki": 0.1, "gains.joint1.p": 600.0, "gains.joint2.p": 10.0, "enabled": True}
    assert with_values(OWN, {"/pid": values}) == OWN


def test_line_breaks_of_another_system_stay():
    text = OWN.replace("\n", "\r\n")
    values = {"ki": 0.25, "kd": 0.5}
    edited = with_values(text, {"/pid": values})
    assert "\n" not in edited.replace("\r\n", "")
    assert edited.replace("\r\n", "\n") == with_values(OWN, {"/pid": values})


class TestWhereAValueIsNot:
    def test_a_parameter_that_the_section_lacks_is_added_to_it(self):
        edited = with_values(OWN, {"/pid": {"kd": 0.5}})
        assert changed_lines(OWN, edited) == ["+     kd: 0.5"]
        assert edited.splitlines()[edited.splitlines().index("    kd: 0.5") - 1] == (
            "    names: [a, b]"
        )

    def test_behind_a_text_in_a_block_and_at_the_end_of_the_file(self):
        text = "pid:\n  ros__parameters:\n    note: |\n      a\n      b\n# end"
        edited = with_values(text, {"/pid": {"kd": 0.5}})
        assert edited == text.replace("# end", "    kd: 0.5\n# end")
        text = "pid:\n  ros__parameters:\n    kp: 1.0  # here"
        assert with_values(text, {"/pid": {"kd": 0.5}}) == f"{text}\n    kd: 0.5"

    def test_also_in_braces(self):
        text = "pid: {ros__parameters: {kp: 1.0, gains: {p: 2.0}}}\n"
        edited = with_values(text, {"/pid": {"kd": 0.5}})
        assert edited == "pid: {ros__parameters: {kp: 1.0, gains: {p: 2.0}, kd: 0.5}}\n"

    def test_a_file_of_other_nodes(self):
        with pytest.raises(StudyError, match="says nothing of the node /axis"):
            with_values(OWN, {"/axis": {"kp": 1.0}})


class TestWildcards:
    def test_one_that_any_node_takes_stays_and_a_section_is_added_behind(self):
        text = "/**:\n  ros__parameters:\n    kp: 1.0\n"
        edited = with_values(text, {"/arm/pid": {"kp": 2.5}})
        assert edited == text + "/arm/pid:\n  ros__parameters:\n    kp: 2.5\n"
        assert read(edited, "/arm/pid") == {"kp": 2.5}
        assert read(edited, "/other") == {"kp": 1.0}

    def test_the_file_may_end_without_a_line_break(self):
        text = "/**:\n  ros__parameters:\n    kp: 1.0"
        assert with_values(text, {"/pid": {"kp": 2.5}}).startswith(text + "\n/pid:\n")

    def test_each_of_several_nodes_gets_a_section(self):
        text = "/**:\n  ros__parameters:\n    kp: 1.0"
        edited = with_values(text, {"/a": {"kp": 2.0}, "/b": {"kp": 3.0, "ki": [1, 2]}})
        assert edited == (
            f"{text}\n/a:\n  ros__parameters:\n    kp: 2.0\n"
            "/b:\n  ros__parameters:\n    kp: 3.0\n    ki: [1, 2]\n"
        )

    def test_the_section_of_the_node_comes_ahead_of_it(self):
        """One of the same name would be read as part of the first."""
        text = "pid:\n  ros__parameters: {kp: 2.0}\n/**:\n  ros__parameters: {kp: 9.0}\n"
        edited = with_values(text, {"/pid": {"kp": 3.0}})
        assert edited == text + "/pid:\n  ros__parameters:\n    kp: 3.0\n"
        # Once more, it is in place.
        assert changed_lines(edited, with_values(edited, {"/pid": {"kp": 4.0}})) == [
            "-     kp: 3.0", "+     kp: 4.0",
        ]  # fmt: skip

    def test_the_section_of_the_node_comes_behind_it(self):
        text = "/**:\n  ros__parameters: {kp: 9.0}\npid:\n  ros__parameters:\n    ki: 1.0\n"
        assert with_values(text, {"/pid": {"kp": 3.0}}) == text + "    kp: 3.0\n"

    def test_one_that_no_other_node_takes_changes_itself(self):
        text = "/**/pid:\n  ros__parameters: {kp: 1.0}\nother:\n  ros__parameters: {a: 1}\n"
        assert with_values(text, {"/arm/pid": {"kp": 2.0}}) == text.replace("1.0", "2.0")

    def test_one_that_another_node_of_the_study_takes(self):
        text = "/**/pid:\n  ros__parameters: {kp: 1.0, ki: 1.0}\n"
        new = {"/a/pid": {"kp": 2.0}, "/b/pid": {"kp": 3.0}}
        edited = with_values(text, new)
        assert [read(edited, node)["kp"] for node in ("/a/pid", "/b/pid", "/pid")] == [
            2.0,
            3.0,
            1.0,
        ]

    def test_what_a_wildcard_has_already_needs_no_section(self):
        text = "/**:\n  ros__parameters: {kp: 1.0}\n"
        assert with_values(text, {"/pid": {"kp": 1.0}}) == text


@pytest.mark.parametrize(
    ("text", "values", "problem"),
    [
        ("pid:\n  ros__parameters:\n    a: &a 1\n    b: *a\n", {"a": 2}, "aliases"),
        ("pid: {ros__parameters: {a: 1}}\nx: 1\n", {"a": 2}, "ahead of ros__parameters"),
        ("pid:\n  ros__parameters:\n    a: |-\n      text\n", {"a": "b"}, "text on one line"),
        ("pid:\n  ros__parameters:\n    a:\n    - 1\n    - 2\n", {"a": [1]}, "expected 1 items"),
        ("pid:\n  ros__parameters:\n    a: [1]\n", {"a": 1}, "expected a single value"),
        # An integer that was given counts before a double that is given later.
        (
            "pid: {ros__parameters: {a: 1}}\npid: {ros__parameters: {a: 2.0}}\n",
            {"a": 3.0},
            "itself",
        ),
        # A list of mappings, which ROS reads as one list.
        ("pid:\n  ros__parameters:\n    a: [{b: p}, {b: q}]\n", {"a.b.b": ["p"]}, "itself"),
    ],
)
def test_a_file_that_is_not_changed(text, values, problem):
    with pytest.raises(StudyError, match=problem) as caught:
        with_values(text, {"/pid": values})
    assert "\n" not in str(caught.value)


SINGLE = st.one_of(
    st.booleans(),
    st.integers(-(2**63) + 1, 2**63 - 1),
    st.floats(allow_nan=False, allow_subnormal=False),
    st.text(st.characters(exclude_categories=("Cs",), exclude_characters="\0"), max_size=8),
)


@given(
    st.dictionaries(
        st.sampled_from(
            ["kp", "ki", "gains.joint1.p", "mode", "style", "plain", "enabled", "new.a"]
        ),
        SINGLE,
    )
)
def test_any_value_reads_back_and_the_rest_of_the_text_stays(values):
    edited = with_values(OWN, {"/pid": values})
    assert repr(sorted(read(edited, "/pid").items())) == repr(
        sorted((read(OWN, "/pid") | values).items())
    )
    assert edited.startswith(
        "# Gains of the arm\npid:   # the node\n  ros__parameters:\n    kp:   "
    )
    assert edited.endswith("\n\n\n# the end\n")
