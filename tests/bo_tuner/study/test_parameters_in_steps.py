"""Tuned parameters without a node: in steps of a run and starts of nodes, by names in braces."""

import pytest
import yaml
from signal_runs import signal_study

from bo_tuner.errors import StudyError
from bo_tuner.storage.parameter_file import node_values, sent_values
from bo_tuner.study.step_values import filled_after, left_by_calls
from bo_tuner.study.study_file import parse_study, study_from_mapping, study_to_yaml

KP = {"type": "double", "bounds": [0.0, 4.0], "default": 1.0}
CALL = {"call": {"service": "/drive/set", "request": {"kp": "{kp}"}}}
STOP = {"publish": {"topic": "/gain", "message": {"data": "{kp}"}}}


def study_of(*, run=None, kp=None, **sections):
    mapping = signal_study(**sections)
    mapping["parameters"]["kp"] = KP | (kp or {})
    mapping["run"] |= {"before": [CALL], "after": [STOP, CALL]} | (run or {})
    return study_from_mapping(mapping)


def refusal(**changes):
    with pytest.raises(StudyError) as error:
        study_of(**changes)
    return str(error.value)


def test_it_is_tuned_and_set_on_no_node():
    study = study_of()
    assert "kp" in study.search_space().defaults
    tuned = study.search_space().defaults | {"kp": 3.0}
    for values in study.node_parameters(tuned), node_values(study, tuned):
        assert all("kp" not in of_node for of_node in values.values())
    assert sent_values(study, tuned) == ["kp = 3.0: stands in run.before[0]; put it there"]
    assert parse_study(study_to_yaml(study)) == study
    assert "node" not in yaml.safe_load(study_to_yaml(study))["parameters"]["kp"]


def test_what_stops_the_machine_has_the_safe_value():
    study = study_of(park={"parameters": {"kp": 0.5}})
    (step,) = filled_after(study.run, study.safe_parameters)
    assert step.publish.message == {"data": 0.5}


STARTED = {"node": "servo", "command": "servo -p kp:={kp} ${HOME} '{{kp}} {room}'"}
ROOM = {"distribution": "discrete", "values": ["the yard", "hall"]}


def started(**changes):
    nodes = {"servo": STARTED | changes}
    return study_of(nodes=nodes, contexts={"room": ROOM}, run={"before": [], "after": []})


def test_what_starts_a_node():
    """A text with blanks is one word, and a small number one that YAML takes for a number."""
    study = started(env={"LOAD": "{room}", "DISPLAY": ":{worker}"})
    node, values = study.nodes["servo"], {"kp": 1e-5, "room": "the yard", "worker": 2}
    words = ["servo", "-p", "kp:=1.0e-05", "${HOME}", "{kp} the yard"]
    assert node.words(values) == words
    assert yaml.safe_load(words[2].partition("=")[2]) == 1e-5
    assert node.environment(values) == {"LOAD": "the yard", "DISPLAY": ":2"}
    said = "kp = 2.0: stands in nodes.servo.command; put it there"
    assert sent_values(study, {"gain": 0.5, "kp": 2.0}) == [said]
    assert parse_study(study_to_yaml(study)) == study


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        (
            {"command": STARTED["command"] + " {kd}"},
            "nodes.servo.command: there is no context or parameter 'kd'; expected one of gain, kp, "
            "room; write {{kd}} for the text {kd}",
        ),
        (
            {"env": {"FILE": "{parameter_file}"}},
            "nodes.servo.env.FILE: there is no context or parameter 'parameter_file'; expected one "
            "of gain, kp, room; write {{parameter_file}} for the text {parameter_file}",
        ),
    ],
)
def test_what_no_start_of_a_node_has(changes, expected):
    with pytest.raises(StudyError) as error:
        started(**changes)
    assert str(error.value) == expected


def stream(**changes):
    return {"publish": {"topic": "/a", "rate": 10.0, "profile": {"data": "{kp} * t"}} | changes}


def test_a_profile():
    study = study_of(run={"before": [stream(), CALL], "after": [stream(duration=2.0)]})
    (step,) = filled_after(study.run, {"kp": -0.5})
    (topic,) = step.publish.ending("")
    assert topic.profile["data"].step.final == -1.0
    assert sent_values(study, {"kp": 2.0})[0].startswith("kp = 2.0: stands in run.before[0] and")


def test_a_call_that_stays_in_force():
    assert list(left_by_calls(study_of().run, {"kp"})) == []
    (said,) = left_by_calls(study_of(run={"after": [STOP]}).run, {"kp"})
    assert said.startswith("run.before[0] sends kp of the trial, which stays in force")


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        (
            {"run": {"before": [], "after": []}},
            "parameters.kp: is used nowhere; expected node, or {kp} in a step of run or in what "
            "starts a node",
        ),
        (
            {"run": {"before": [{"call": {"service": "/s", "request": {"x": "{kpp}"}}}]}},
            "run.before[0].call.request: there is no context or parameter 'kpp'; did you mean "
            "'kp'?",
        ),
        (
            {"run": {"abort_when": "angle > {kp}"}},
            "run.abort_when: expected no name in braces, found 'kp': it must hold whatever a test "
            "run is",
        ),
        (
            {
                "run": {"before": [stream(profile={"data": "{room} + {kp}"})]},
                "contexts": {"room": ROOM},
            },
            "run.before[0].publish.profile.data: 'room' is a text; expected a number or a truth "
            "value",
        ),
        (
            {
                "run": {"after": [stream(profile={"data": "{goal}"}, duration=1.0)]},
                "contexts": {"goal": {"distribution": "uniform", "bounds": [0, 1]}},
            },
            "run.after[0].publish.profile.data: expected no context, found 'goal': it must hold "
            "whatever a test run is",
        ),
        (
            {"kp": {"parameter": "gains.p"}},
            "parameters.kp.parameter: without a node there is no parameter; add node",
        ),
        (
            {"contexts": {"kp": {"distribution": "uniform", "bounds": [0, 1]}}},
            "run.before[0].call.request: 'kp' is both a context and a parameter; rename one",
        ),
    ],
)
def test_refusals(changes, expected):
    assert refusal(**changes) == expected
