"""Nodes of a study that take parameters only while they start."""

import pytest

from bo_tuner.errors import StudyError
from bo_tuner.study.at_start import starter_of
from bo_tuner.study.in_force import in_force
from bo_tuner.study.study_file import parse_study, study_from_mapping, study_to_yaml

PID = {"node": "pid", "command": "python3 pid.py"}


def make(pid=None, **sections):
    number = {"type": "double", "bounds": [0.1, 2.0], "default": 1.0}
    mapping = {
        "name": "servo",
        "nodes": {"pid": PID | {"at_start": True} | (pid or {}), "motor": {"node": "motor"}},
        "parameters": {
            "p": {"node": "pid", "parameter": "gains.p"} | number,
            "weights[1]": {"node": "pid"} | number,
        },
        "contexts": {"load": {"node": "pid", "distribution": "uniform", "bounds": [1, 2]}},
        "signals": {"angle": {"topic": "angle", "field": "data"}},
        "run": {"end": {"after": 1.0}},
        "metrics": {"error": {"of": "angle", "measure": "iae"}},
        "objective": {"metric": "error"},
        "budget": {"trials": 4, "initial_trials": 2},
    }
    mapping["nodes"]["pid"]["parameters"] = {"weights": [1.0, 2.0], "rate": 100}
    return study_from_mapping(mapping | sections)


def test_all_that_the_study_sets_on_the_node():
    """As the node calls it; an array is taken as a whole."""
    assert make().start_names == {"pid": {"gains.p", "weights", "rate", "load"}}


def test_names_in_the_study():
    named = ["p", "weights[1]"]
    assert make({"at_start": named}).start_names == {"pid": {"gains.p", "weights"}}


def test_it_is_in_the_file_of_the_run():
    study = make({"at_start": ["p"], "parameter_file": "own.yaml", "reconfigure": True})
    assert parse_study(study_to_yaml(study)) == study
    assert make({"at_start": False}).start_names == {}


@pytest.mark.parametrize(
    "way", [True, "controller_manager", [{"call": {"service": "/pid/reload"}}]]
)
def test_a_node_that_is_configured_anew_takes_its_values_so(way):
    study = make({"at_start": False, "reconfigure": way})
    assert study.start_names == make().start_names
    assert parse_study(study_to_yaml(study)) == study


@pytest.mark.parametrize(
    ("pid", "way"),
    [
        ({"at_start": False}, "set on pid while it runs, and read back"),
        ({}, "given to pid at its start, and read back"),
        ({"reconfigure": True}, "set on pid and read back, when it is configured anew"),
        (
            {"reconfigure": "controller_manager"},
            "set on pid and read back, once the controller_manager has configured it anew",
        ),
        (
            {"reconfigure": [{"call": {"service": "/pid/reload"}}]},
            "set on pid and read back, once its steps of reconfigure are done",
        ),
    ],
)
def test_how_it_is_known_that_values_are_in_force(pid, way):
    assert in_force(make(pid)) == (f"in force: p and weights[1], {way}",)


def test_of_what_nothing_reads_back():
    number = {"type": "double", "bounds": [0.1, 2.0], "default": 1.0}
    study = make(
        nodes={"pid": PID | {"command": "pid {q}"}, "motor": {"node": "motor"}},
        parameters={"q": number, "r": {"node": "motor"} | number},
        contexts={},
    )
    assert in_force(study) == (
        "in force: q, as it stands in nodes.pid.command, which nothing reads back",
        "in force: r, set on motor while it runs, and read back",
    )


@pytest.mark.parametrize(
    ("pid", "complaint"),
    [
        ({"at_start": ["q"]},
         "nodes.pid.at_start[0]: there is no parameter of the node 'q'; expected one of weights, "
         "rate, p, weights[1], load"),
        ({"at_start": []},
         "nodes.pid.at_start: expected true, or the names of parameters of the study, found an "
         "empty list"),
        ({"at_start": "p"},
         "nodes.pid.at_start: expected true, or the names of parameters of the study, found text "
         "'p'"),
        ({"at_start": [1]}, "nodes.pid.at_start[0]: expected text, found 1"),
        ({"reconfigure": "manager"},
         "nodes.pid.reconfigure: expected true, controller_manager, or a list of steps that are "
         "calls or lifecycle, found text 'manager'"),
        ({"reconfigure": [{"call": {"service": "reload"}}, {"wait": 1.0}]},
         "nodes.pid.reconfigure[1]: expected a call or a lifecycle"),
        ({"reconfigure": [{"call": {"servce": "reload"}}]},
         "nodes.pid.reconfigure[0].call.servce: unknown key; did you mean 'service'?"),
        ({"at_start": False, "parameter_file": "a.yaml"},
         "nodes.pid.parameter_file: belongs to a node with at_start; add at_start: true"),
        ({"at_start": False, "command": "pid --params {parameter_file}"},
         "nodes.pid.command: nothing would be in {parameter_file}: add at_start: true to the node"),
        ({"command": None, "launch": "robot up.launch.py"},
         "nodes.pid.launch: expected {parameter_file} where the launch file takes a parameter "
         "file, such as params_file:={parameter_file}"),
    ],
)  # fmt: skip
def test_refusals(pid, complaint):
    with pytest.raises(StudyError) as caught:
        make(pid)
    assert str(caught.value) == complaint


@pytest.mark.parametrize("reads", [True, False])
def test_an_item_that_its_array_does_not_have(reads):
    number = {"type": "double", "bounds": [0.1, 2.0], "default": 1.0}
    changes = {} if reads else {"at_start": False}
    with pytest.raises(StudyError) as caught:
        make(changes, parameters={"weights[2]": {"node": "pid"} | number})
    assert str(caught.value) == (
        "nodes.pid.parameters.weights: has 2 items, so that there is no 'weights[2]'"
    )


def test_a_node_on_which_nothing_is_set():
    nodes = {"pid": PID, "motor": {"node": "motor", "at_start": True}}
    nodes["pid"] = nodes["pid"] | {"parameters": {"weights": [1.0, 2.0]}}
    with pytest.raises(StudyError) as caught:
        make(nodes=nodes)
    assert str(caught.value) == "nodes.motor.at_start: the study sets no parameter of this node"


@pytest.mark.parametrize(
    ("motor", "starter"),
    [
        ({"command": "python3 motor.py"}, "motor"),
        ({}, "pid"),
    ],
)
def test_who_starts_a_node(motor, starter):
    """One that says nothing of it comes with what passes the file on."""
    launch = {"launch": "robot up.launch.py file:={parameter_file}"}
    nodes = {"pid": {"node": "pid", "at_start": True} | launch, "motor": {"node": "motor"} | motor}
    nodes["pid"]["parameters"] = {"weights": [1.0, 2.0]}
    assert starter_of(make(nodes=nodes).nodes, "motor") == starter


def test_nobody_may_start_a_node():
    assert starter_of(make().nodes, "motor") is None
