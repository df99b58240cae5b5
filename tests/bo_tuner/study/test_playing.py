"""Bags in a study file."""

import pytest
from rosbags.rosbag2 import Writer
from rosbags.typesys import Stores, get_typestore

from bo_tuner.codec.reading import read
from bo_tuner.errors import StudyError
from bo_tuner.study.playing import Play, with_bags
from bo_tuner.study.run import Run

TYPES = get_typestore(Stores.ROS2_JAZZY)


def run(**changed):
    given = {"clock": "sim", "start": [{"play": "drive"}], "end": "played"} | changed
    return read(Run, given)


def refusal(function, *arguments, **keywords):
    with pytest.raises(StudyError) as caught:
        function(*arguments, **keywords)
    return str(caught.value)


def test_a_bag_is_all_that_a_run_is():
    assert run().play == Play(bag="drive")
    assert run().end.played
    cases = {
        "clock: expected sim": {"clock": "wall"},
        "end: expected played": {"end": {"after": 2.0}},
        "start: expected play alone": {"start": [{"play": "drive"}, {"wait": 1.0}]},
        "before[0].play: is a run of its own": {"before": [{"play": "drive"}]},
        "end.played: start has no play": {"start": [{"wait": 1.0}], "clock": "wall"},
    }
    for expected, changed in cases.items():
        assert refusal(run, **changed).startswith(expected)


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        ({"bag": ""}, "bag: expected the folder or file of a bag"),
        ({"bag": "a", "lockstep": False, "answers": {"/a": "/b"}}, "answers: are waited for"),
        ({"bag": "a", "rate": 0}, "rate: expected a number above 0"),
        ({"bag": "a", "begin": 3.0, "end": 2.0}, "end: expected more than begin, 3 s"),
        ({"bag": "a", "drop": {"/a": 1.5}}, "drop./a: expected 0 to 1, found 1.5"),
        ({"bag": "a", "delay": {"/a": -1}}, "delay./a: expected 0 to 60 s, found -1"),
        ({"bag": "a", "answers": {"/a": {"topic": "/b", "every": 0}}}, "answers./a.every: exp"),
        ({"bag": "a", "noise": {"/a": {"z": -1}}}, "noise./a.z: expected at least 0, found -1.0"),
        ({"bag": "a", "noise": {"/a": 0.1}}, "noise./a: expected "),
    ],
)
def test_what_cannot_be_played(given, expected):
    assert refusal(read, Play, given).startswith(expected)


@pytest.fixture
def folder(tmp_path):
    """A folder with three that look like bags, and one that does not."""
    for name in ("b", "a"):
        (tmp_path / "drives" / name).mkdir(parents=True)
        (tmp_path / "drives" / name / "metadata.yaml").touch()
    (tmp_path / "drives" / "c.mcap").touch()
    (tmp_path / "drives" / "notes.txt").touch()
    return tmp_path


def contexts(folder, **given):
    return with_bags({"contexts": {"drive": given}}, folder)["contexts"]["drive"]


def test_bags_as_the_values_of_a_context(folder):
    names = ["drives/a", "drives/b", "drives/c.mcap"]
    assert contexts(folder, bags=["drives/*"], unit="drive") == {
        "distribution": "discrete",
        "values": names,
        "unit": "drive",
    }
    weighted = contexts(folder, bags=names, weights=[2, 1, 1])
    assert weighted["probabilities"] == [0.5, 0.25, 0.25]


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        ({"bags": ["drives/a"]}, "contexts.drive.bags: expected at least two bags, found 1"),
        ({"bags": ["rides/*"]}, "contexts.drive.bags[0]: no bag in "),
        ({"bags": ["drives/*", "drives/a"]}, "contexts.drive.bags[1]: 'drives/a' is named twice"),
        ({"bags": ["drives/*"], "weights": [1]}, "contexts.drive.weights: expected one for each"),
        ({"bags": ["a", "b"], "distribution": "discrete"}, "contexts.drive.distribution: stands"),
    ],
)
def test_bags_that_are_no_context(folder, given, expected):
    assert refusal(contexts, folder, **given).startswith(expected)


def test_pieces_of_bags(tmp_path):
    """About as long as wanted, those of one bag equally long, and weighted as one."""
    for name, seconds in (("long", 130.0), ("short", 20.0)):
        with Writer(tmp_path / name, version=9) as writer:
            connection = writer.add_connection("/a", "std_msgs/msg/Bool", typestore=TYPES)
            for time in (1.0, 1.0 + seconds):
                writer.write(connection, round(time * 1e9), bytes(5))
    made = contexts(tmp_path, bags=["long", "short"], split=60.0, weights=[1, 1])
    assert made["values"] == ["long@0.000-65.000", "long@65.000-130.000", "short@0.000-20.000"]
    assert made["probabilities"] == [0.25, 0.25, 0.5]
    played = Play(bag="{drive}").filled({"drive": made["values"][1]})
    assert (played.bag, played.begin, played.end) == ("long", 65.0, 130.0)
    # A single one has several pieces.
    assert len(contexts(tmp_path, bags=["long"], split=60.0)["values"]) == 2
    assert refusal(contexts, tmp_path, bags=["none"], split=60.0).startswith(
        f"contexts.drive.bags: '{tmp_path / 'none'}' cannot be read: "
    )


def test_contexts_in_braces():
    play = read(Play, {"bag": "{drive}", "drop": {"/a": "{lost}"}, "noise": {"/b": {"z": "{sd}"}}})
    assert [*play.names_in_braces] == [
        (("bag",), "drive", False),
        (("drop", "/a"), "lost", True),
        (("noise", "/b", "z"), "sd", True),
    ]
    filled = play.filled({"drive": "one", "lost": 0.1, "sd": 0.2})
    assert (filled.bag, filled.drop, filled.noise) == ("one", {"/a": 0.1}, {"/b": {"z": 0.2}})
