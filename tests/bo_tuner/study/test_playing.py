"""Bags in a study file."""

import pytest

from bo_tuner.codec.reading import read
from bo_tuner.errors import StudyError
from bo_tuner.study.playing import Play, with_bags
from bo_tuner.study.run import Run


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
