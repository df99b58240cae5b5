"""What a signal is of a message: the grammar of fields, and what is none of it."""

import pytest

from bo_tuner.errors import StudyError
from bo_tuner.study.fields import FieldCall, FieldPart, has_names, parsed_field, paths
from bo_tuner.study.signals import Signal

RANGES = (FieldPart("ranges"),)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("data", (FieldPart("data"),)),
        ("min(ranges)", FieldCall("min", (RANGES,))),
        (" min( ranges , 10 ) ", FieldCall("min", (RANGES, 10.0))),
        ("max(-1e-3, ranges, .5)", FieldCall("max", (-1e-3, RANGES, 0.5))),
        ("mean(finite(ranges))", FieldCall("mean", (FieldCall("finite", (RANGES,)),))),
        ("min(ranges[10:20])", FieldCall("min", ((FieldPart("ranges", slice(10, 20)),),))),
        ("min(ranges[:5])", FieldCall("min", ((FieldPart("ranges", slice(None, 5)),),))),
        (
            "norm(twist.linear.x, twist.linear.y)",
            FieldCall(
                "norm",
                tuple((FieldPart("twist"), FieldPart("linear"), FieldPart(n)) for n in "xy"),
            ),
        ),
        (
            "max(position[a,b(c.d)], position[arm:wrist])",
            FieldCall(
                "max", ((FieldPart("position", "a,b(c.d)"),), (FieldPart("position", "arm:wrist"),))
            ),
        ),
        ("yaw(rotation)", FieldCall("yaw", ((FieldPart("rotation"),),))),
        # A field may be called as a function is.
        ("max", (FieldPart("max"),)),
    ],
)
def test_fields(text, expected):
    assert parsed_field(text) == expected


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("norn(ranges)", "there is no function 'norn' of fields; did you mean 'norm'"),
        ("sqrt(x)", "no function 'sqrt' of fields; expected one of min, max, mean, sum, norm, len"),
        ("min()", "expected a field such as data"),
        ("min(ranges", "expected a field such as data"),
        ("min(ranges))", "expected a field such as data"),
        ("min(a) + max(b)", "expected a field such as data"),
        ("min(a, )", "expected a field such as data"),
        ("min(a b)", "expected a field such as data"),
        ("min(__import__('os'))", "there is no function '__import__'|expected a field"),
        ("min(3)", "min needs a field, found text '3'"),
        ("3", "expected a field, found text '3'"),
        ("len(a, b)", "len takes 1 argument, found 2"),
        ("min(abs(a, b))", "abs takes 1 argument, found 2"),
        ("yaw(min(a))", "yaw is of a quaternion; expected a field"),
        ("abs(x)", r"abs leaves an array; expected one number of it, such as min\(abs\(x\)\)"),
        ("finite(ranges)", "finite leaves an array"),
        ("ranges[1:3]", r"several items are no number; expected one of them, such as min\("),
        ("min(" * 200 + "a" + ")" * 200, "expected at most 500 characters"),
    ],
)
def test_no_fields(text, complaint):
    with pytest.raises(StudyError, match=complaint):
        parsed_field(text)


def test_deep_but_short_calls_are_read():
    assert len(list(paths(parsed_field("min(" * 90 + "a" + ")" * 90)))) == 1


def test_names_of_items_are_found_in_calls():
    assert has_names(parsed_field("max(abs(effort[elbow]), 3)"))
    assert not has_names(parsed_field("max(effort[3], ranges[1:2])"))


@pytest.mark.parametrize(
    ("keys", "complaint"),
    [
        ({"field": "data"}, "topic: missing"),
        ({"frames": ["map", "base"]}, "field: missing; expected a field of a transform"),
        ({"frames": ["map"], "field": "x"}, r"frames: expected \[frame, other\], as \[map, base"),
        ({"frames": ["map", "map"], "field": "x"}, "frames: expected two frames, found 'map'"),
        (
            {"frames": ["map", 3], "field": "x"},
            r"frames\[1\]: expected a frame such as map, found 3",
        ),
        ({"frames": ["map", "/b"], "field": "x"}, r"frames\[1\]: expected a frame such as map"),
        ({"topic": "a", "field": "b", "merge": 1}, "merge: expected true or false, found 1"),
        ({"topic": "a", "field": "b", "publisher": "a b"}, "publisher: expected a node name such"),
        (
            {"topic": "a", "field": "b", "publisher": "c", "merge": True},
            "publisher: messages of one node or of all; leave out publisher or merge",
        ),
    ],
)
def test_refused_keys_of_a_signal(keys, complaint):
    with pytest.raises(StudyError, match=complaint):
        Signal(name="s", **keys)


def test_transforms_are_on_tf_unless_the_study_says_otherwise():
    signal = Signal(name="x", frames=["map", "base"], field="translation.x")
    assert (signal.topic, signal.frames) == ("/tf", ("map", "base"))
    assert signal.source == "/tf map base"
    other = Signal(name="x", topic="/r1/tf", frames=["map", "base"], field="translation.x")
    assert other.topic == "/r1/tf"
