"""Streams of a study: what is read, written and refused."""

import numpy as np
import pytest
import yaml
from signal_runs import signal_study

from bo_tuner.errors import StudyError
from bo_tuner.storage.trust import foreign_programs
from bo_tuner.study.study_file import (
    load_study,
    parse_study,
    study_from_mapping,
    study_to_yaml,
)

SINE = {"sine": {"amplitude": 1.0, "frequency": 0.5}}
STREAM = {"topic": "/setpoint", "rate": 50, "profile": {"data": SINE}}
BOTH = {
    "rate": 20.0,
    "duration": 3.0,
    "topics": [
        {
            "topic": "/left",
            "profile": {"data": "0.5 * sin(2 * pi * t)"},
            "follow": {"data": "angle"},
        },
        {"topic": "/right", "message": {"data": 1.0}},
    ],
}


def mapping(*steps, **phases):
    return signal_study(run={"start": list(steps), "end": {"after": 2.0}, **phases})


def study(*steps, **phases):
    return study_from_mapping(mapping(*steps, **phases))


def refusal(*steps, **phases):
    with pytest.raises(StudyError) as caught:
        study(*steps, **phases)
    return str(caught.value)


def values(step, time, topic=0, field="data"):
    (found,) = study({"publish": step}).run.start
    profile = found.publish.published[topic].profile[field]
    return profile.function("")(np.asarray(time)).tolist()


def test_what_is_written_reads_back_equal():
    found = study({"publish": STREAM}, {"wait": 0.1}, {"stop": "/setpoint"}, {"publish": BOTH})
    assert parse_study(study_to_yaml(found)) == found


def test_two_topics_have_a_time_base():
    assert values(BOTH, [0.0, 0.25], 0) == pytest.approx([0.0, 0.5])
    (step,) = study({"publish": BOTH}).run.start
    assert [topic.topic for topic in step.publish.published] == ["/left", "/right"]


@pytest.mark.parametrize(
    ("profile", "time", "expected"),
    [
        ({"step": {"final": 2.0, "after": 1.0}}, [0.9, 1.0], [0.0, 2.0]),
        ({"ramp": {"final": 1.0, "duration": 2.0}}, [1.0, 3.0], [0.5, 1.0]),
        (SINE, [0.5], [1.0]),
        ({"chirp": {"amplitude": 1, "frequencies": [1, 1], "duration": 4}}, [0.25], [1.0]),
        ({"multisine": {"amplitude": 2, "frequencies": [1], "offset": 1}}, [0.25], [3.0]),
        ("min(t, 1) * 3", [0.5, 2.0], [1.5, 3.0]),
    ],
)
def test_profiles(profile, time, expected):
    assert values(STREAM | {"profile": {"data": profile}}, time) == pytest.approx(expected)


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        ({"rate": 0}, "publish.rate: expected a number above 0"),
        ({"rate": 2000}, "publish.rate: expected a number above 0 and at most 1000 Hz"),
        ({"rate": None}, "publish.rate: missing; expected how often, for profile"),
        ({"rate": 0.9}, "0.5 Hz cannot be seen in 0.9 messages a second"),
        ({"duration": -1}, "publish.duration: expected a number above 0"),
        ({"largest_gap": 0.02}, "publish.largest_gap: 0.02 s are no more than a period"),
        ({"topic": ""}, "publish.topic: missing"),
        ({"topics": BOTH["topics"]}, "publish.topic: stands beside topics"),
        ({"profile": {"data": {}}}, "profile.data: expected one of step, ramp, sine"),
        ({"profile": {"data": SINE | {"step": {"final": 1}}}}, "profile.data: expected one of"),
        ({"profile": {"data": 3.0}}, "profile.data: expected an expression of t"),
        ({"profile": {"data": {"sin": {}}}}, "profile.data.sin: unknown key"),
        ({"profile": {"data": {"sine": {"amplitude": 1}}}}, "sine.frequency: missing"),
        ({"profile": {"data": {"ramp": {"final": 1, "duration": 0}}}}, "ramp.duration: expected"),
        ({"profile": {"data": {"step": {"final": 1, "after": -1}}}}, "step.after: expected 0 to"),
        ({"profile": {"data": "sin(x)"}}, "there is no name or function 'x'"),
        ({"profile": {"data": "sin("}}, "profile.data.expression: not an expression"),
        ({"profile": {"data[": "t"}}, "profile.data[: expected a field such as data"),
        ({"profile": [1]}, "publish.profile: expected fields such as"),
        ({"follow": {"data": "speed"}}, "follow.data: there is no signal 'speed'"),
        ({"follow": {"date": "angle"}}, "publish.follow: there is no field in profile 'date'"),
        ({"follow": "angle"}, "publish.follow: expected fields such as {data: angle}"),
    ],
)  # fmt: skip
def test_what_no_stream_can_be(change, complaint):
    step = {key: value for key, value in {**STREAM, **change}.items() if value is not None}
    assert complaint in refusal({"publish": step})


@pytest.mark.parametrize(
    ("multisine", "complaint"),
    [
        ({"frequencies": [1]}, "expected one of amplitude and amplitudes"),
        ({"frequencies": [1], "amplitude": 1, "amplitudes": [1]}, "expected one of amplitude and"),
        ({"frequencies": [1, 2], "amplitudes": [1]}, "amplitudes: expected one for each of 2"),
        ({"frequencies": [1], "amplitude": 1, "phases": [0, 1]}, "phases: expected one for each"),
        ({"frequencies": [], "amplitude": 1}, "frequencies: expected at least one"),
        ({"frequencies": [-1], "amplitude": 1}, "frequencies[0]: expected a number above 0"),
    ],
)
def test_what_no_multisine_can_be(multisine, complaint):
    profile = {"data": {"multisine": multisine}}
    assert complaint in refusal({"publish": STREAM | {"profile": profile}})


def test_topics_that_are_named_twice():
    topics = [{"topic": "/left"}, {"topic": "left"}]
    assert "topics[1].topic: left stands here twice" in refusal(
        {"publish": {"rate": 1.0, "topics": topics}}
    )


def test_what_brings_the_machine_to_rest_comes_to_an_end():
    assert "run.after[0].publish.duration: missing" in refusal(after=[{"publish": STREAM}])
    study(after=[{"publish": STREAM | {"duration": 1.0}}])


def test_a_signal_follows_in_a_run_only():
    after = STREAM | {"duration": 1.0, "follow": {"data": "angle"}}
    assert "run.after[0].publish.follow: is judged in a run" in refusal(after=[{"publish": after}])


def test_the_end_of_a_stream_that_no_step_begins():
    complaint = "run.start[1].stop: no step before it begins a stream on /setpoin; did you mean"
    assert complaint in refusal({"publish": STREAM}, {"stop": "/setpoin"})
    study({"stop": "setpoint"}, before=[{"publish": STREAM}])


@pytest.mark.parametrize(
    ("wait", "complaint"),
    [
        ({"hold": -0.1}, "wait_until.hold: expected at least 0 s"),
        ({"rising": 1}, "wait_until.rising: expected true or false"),
    ],
)
def test_what_no_wait_can_be(wait, complaint):
    assert complaint in refusal({"wait_until": {"condition": "angle > 1", **wait}})


@pytest.fixture
def written(tmp_path):
    """Function that writes a study whose reference is a file, and the file; returns its path."""

    def write(content, csv=None, **stream):
        profile = {"csv": {"file": "ref.csv", "column": "x"} | (csv or {})}
        path = tmp_path / "study.yaml"
        step = STREAM | {"profile": {"data": profile}} | stream
        path.write_text(yaml.safe_dump(mapping({"publish": step})))
        if content is not None:
            (tmp_path / "ref.csv").write_bytes(content)
        return path

    return write


@pytest.mark.parametrize(("between", "middle"), [("linear", 2.0), ("hold", 1.0)])
def test_a_reference_in_a_file(written, between, middle, monkeypatch):
    path = written(b"t, x\n0, 1\n\n1, 3\n", {"between": between})
    found = load_study(path)
    # From whatever folder it is run, also by the record of a run.
    monkeypatch.chdir("/")
    again = parse_study(study_to_yaml(found))
    profile = again.run.start[0].publish.profile["data"]
    assert profile.function(again.folder)(np.array([0.5, 9.0])).tolist() == [middle, 3.0]


def test_a_file_is_no_program(written):
    assert foreign_programs(load_study(written(b"t,x\n0,1\n1,3\n"))) == []


def test_a_file_that_has_changed(written, tmp_path):
    found = load_study(written(b"t,x\n0,1\n1,3\n"))
    (tmp_path / "ref.csv").write_bytes(b"t,x\n0,1\n1,4\n")
    profile = found.run.start[0].publish.profile["data"]
    with pytest.raises(StudyError, match="is another one than when the study was read"):
        profile.function(found.folder)


@pytest.mark.parametrize(
    ("content", "csv", "complaint"),
    [
        (None, {}, "ref.csv: cannot be read: No such file"),
        (b"t,x\n0,1\n1,2\n", {"column": "y"}, "ref.csv:1: has no column 'y' in its first line"),
        (b"t,x\n0,1\n1,2\n", {"time": "s"}, "ref.csv:1: has no column 's' in its first line"),
        (b"", {}, "ref.csv:1: has no column 't'"),
        (b"t,x\n0,1\n", {}, "ref.csv: expected at least 2 rows of numbers, found 1"),
        (b"t,x\n0,1\n2,2\n1,3\n", {}, "ref.csv:4: t 1 is not after 2"),
        (b"t,x\n0,1\n0,2\n", {}, "ref.csv:3: t 0 is not after 0"),
        (b"t,x\n0,1\n1,nan\n", {}, "ref.csv:3: x: expected a finite number, found 'nan'"),
        (b"t,x\n0,1\n1\n", {}, "ref.csv:3: x: expected a finite number, found ''"),
        (b"t,x\n0,1\n1,\xff\n", {}, "ref.csv: expected UTF-8 text"),
    ],
)
def test_a_file_that_is_no_reference(written, content, csv, complaint):
    with pytest.raises(StudyError) as caught:
        load_study(written(content, csv))
    assert complaint in str(caught.value)
    assert "run.start[0].publish.profile.data.csv.file" in str(caught.value)


def test_an_expression_that_is_not_finite(written):
    path = written(None, profile={"data": "1 / (0.5 - t)"})
    with pytest.raises(StudyError, match=r"profile\.data: is inf at 0\.5 s; expected a finite"):
        load_study(path)
