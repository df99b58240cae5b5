"""Parameters that are no numbers, items of arrays, steps and nested names."""

import numpy as np
import pytest

from bo_tuner.errors import ParameterError, StudyError
from bo_tuner.storage.parameter_file import from_yaml, node_values, to_yaml
from bo_tuner.study.study_file import parse_study, study_to_yaml

NODE = {"node": "axis"}
COVARIANCE = [1.0, 0.0, 0.0, 2.0]
PARAMETERS = {
    "FollowPath.max_vel_x": NODE | {"type": "double", "bounds": [0.1, 1.0], "default": 0.5},
    "planner": NODE | {"type": "string", "choices": ["rrt", "a_star", "prm"], "default": "a_star"},
    "use_feedforward": NODE | {"type": "boolean", "default": False},
    "covariance[3]": NODE | {"type": "double", "bounds": [0.5, 4.0], "default": 2.0},
    "covariance[0]": NODE | {"type": "double", "tied_to": "covariance[3]"},
    "window": NODE | {"type": "integer", "bounds": [3, 20], "step": 4, "default": 7},
    "rate": NODE | {"type": "double", "bounds": [1.0, 2.0], "step": 0.25, "default": 1.5},
    "frame": NODE | {"type": "string", "fixed": "map"},
}
AXIS = NODE | {"result": "~/cut_result", "object": "a:A", "parameters": {"covariance": COVARIANCE}}


@pytest.fixture
def study(make_study):
    return make_study(nodes={"axis": AXIS}, parameters=PARAMETERS)


def test_a_study_file_keeps_them(study):
    again = parse_study(study_to_yaml(study))
    assert again == study
    assert again.search_space().defaults["planner"] == "a_star"


def test_a_study_file_keeps_an_empty_text(make_study):
    parameters = PARAMETERS | {
        "filter": NODE | {"type": "string", "choices": ["", "median"], "default": ""},
        "prefix": NODE | {"type": "string", "fixed": ""},
    }
    study = make_study(nodes={"axis": AXIS}, parameters=parameters)
    assert parse_study(study_to_yaml(study)) == study


def test_a_step_may_lead_through_zero(make_study):
    """-0.3 and three steps of 0.1 are 5.6e-17."""
    changed = NODE | {"type": "double", "bounds": [-0.3, 0.3], "step": 0.1, "default": 0.0}
    study = make_study(nodes={"axis": AXIS}, parameters=PARAMETERS | {"rate": changed})
    assert study.search_space().defaults["rate"] == 0.0


def test_a_starting_set_between_two_steps(make_study):
    """It could be the result, which the steps exclude."""
    with pytest.raises(StudyError) as caught:
        make_study(nodes={"axis": AXIS}, parameters=PARAMETERS, start=["default", {"rate": 1.6}])
    expected = "start[1].rate: 1.6 is not 1.0 plus a multiple of the step 0.25"
    assert expected in str(caught.value)


def test_points_of_the_cube_are_permitted_values(study):
    space = study.search_space()
    seen = {name: set() for name in PARAMETERS}
    for point in space.repair(np.random.default_rng(1).uniform(size=(400, space.dimension))):
        parameters = space.to_parameters(point)
        again = space.to_parameters(space.to_cube(parameters))
        assert space.key(again) == space.key(parameters)
        assert parameters["covariance[0]"] == parameters["covariance[3]"]
        for name, value in parameters.items():
            seen[name].add(value)
    assert seen["planner"] == {"rrt", "a_star", "prm"}
    assert seen["use_feedforward"] == {False, True}
    assert seen["window"] == {3, 7, 11, 15, 19}
    assert seen["rate"] == {1.0, 1.25, 1.5, 1.75, 2.0}
    assert seen["frame"] == {"map"}
    assert {type(value) for value in seen["use_feedforward"]} == {bool}


def test_a_design_has_all_choices_equally_often(study):
    space = study.search_space()
    design = space.latin_hypercube(30, np.random.default_rng(2))
    sets = [space.to_parameters(point) for point in design]
    for choice in ("rrt", "a_star", "prm"):
        assert sum(item["planner"] == choice for item in sets) == 10
    assert sum(item["use_feedforward"] for item in sets) == 15


def test_a_neighbour_of_a_choice_is_every_other(study):
    space = study.search_space()
    default = space.defaults
    found = [n for n in space.integer_neighbours(default) if n["planner"] != default["planner"]]
    assert sorted(n["planner"] for n in found) == ["prm", "rrt"]
    windows = {n["window"] for n in space.integer_neighbours(default)}
    assert windows == {3, 7, 11}
    assert {n["rate"] for n in space.neighbours(default)} == {1.25, 1.5, 1.75}


def test_an_item_is_set_as_its_whole_array(study):
    parameters = study.search_space().defaults | {"covariance[3]": 3.0, "covariance[0]": 3.0}
    values = study.assignments(parameters, {"load": 1.0}, 1)["axis"]
    assert values["covariance"] == (3.0, 0.0, 0.0, 3.0)
    assert values["FollowPath.max_vel_x"] == 0.5
    assert values["use_feedforward"] is False
    assert not any("[" in name for name in values)


def test_an_array_of_doubles_may_be_written_with_integers(make_study):
    """A ROS array has one type."""
    axis = AXIS | {"parameters": {"covariance": [1, 0, 0, 1]}}
    made = make_study(nodes={"axis": axis}, parameters=PARAMETERS)
    values = made.node_parameters({"covariance[0]": 0.5})["axis"]["covariance"]
    assert values == (0.5, 0.0, 0.0, 1.0)
    assert {type(value) for value in values} == {float}


def test_a_parameter_file_holds_them(study):
    """As ROS reads it: text stays text, and an integer does not become a double."""
    defaults = study.search_space().defaults
    values = node_values(study, defaults)
    read = from_yaml(to_yaml(values))["axis"]
    assert read == values["axis"]
    assert read["covariance"] == [2.0, 0.0, 0.0, 2.0]
    assert (read["planner"], read["use_feedforward"], read["window"]) == ("a_star", False, 7)
    assert type(read["window"]) is int


@pytest.mark.parametrize(
    ("name", "value", "problem"),
    [
        ("planner", "dijkstra", "planner: unknown 'dijkstra'; expected one of rrt, a_star, prm"),
        ("use_feedforward", 1, "use_feedforward: expected true or false, found 1"),
        ("window", True, "window: expected an integer, found true"),
    ],
)
def test_values_of_another_kind(study, name, value, problem):
    space = study.search_space()
    with pytest.raises(ParameterError) as caught:
        space.to_cube(space.defaults | {name: value})
    assert str(caught.value) == problem


@pytest.mark.parametrize(
    ("name", "changes", "problem"),
    [
        ("planner", {"choices": None}, "choices: missing; expected a list of two or more"),
        ("planner", {"choices": ["rrt", "rrt"]}, "choices: expected a list of two or more"),
        ("planner", {"bounds": [0, 1]}, "bounds: a string has no bounds; leave it out"),
        ("planner", {"scale": "log"}, "scale: a string has no scale; leave it out"),
        ("planner", {"default": "dijkstra"}, "default: unknown 'dijkstra'"),
        ("use_feedforward", {"default": 0}, "default: expected true or false, found 0"),
        ("use_feedforward", {"choices": ["a", "b"]}, "choices: a boolean has no choices"),
        ("use_feedforward", {"default": None}, "default: missing"),
        ("window", {"choices": ["a", "b"]}, "choices: a number has no choices; leave it out"),
        ("window", {"step": 40}, "step: expected above 0 and within the bounds, found 40"),
        ("window", {"default": 8}, "default: 8 is not 3 plus a multiple of the step 4"),
        ("rate", {"step": 0.0}, "step: expected above 0 and within the bounds, found 0.0"),
        ("rate", {"type": "number"}, "type: unknown 'number'"),
        ("rate", {"parameter": "a[01]"}, "parameter: expected a ROS parameter name such as"),
    ],
)
def test_refused_definitions(make_study, name, changes, problem):
    item = {k: v for k, v in (PARAMETERS[name] | changes).items() if v is not None}
    with pytest.raises(StudyError) as caught:
        make_study(nodes={"axis": AXIS}, parameters=PARAMETERS | {name: item})
    assert f"parameters.{name}.{problem}" in str(caught.value)


@pytest.mark.parametrize(
    ("array", "problem"),
    [
        ({}, "missing; expected the array of which 'covariance[3]' is an item"),
        ({"covariance": 1.0}, "expected an array, found 1.0"),
        ({"covariance": [1.0, 2.0]}, "has 2 items, so that there is no 'covariance[3]'"),
        ({"covariance": ["a"] * 4}, "expected a number, found text 'a'"),
    ],
)
def test_items_of_arrays_that_are_not_there(make_study, array, problem):
    with pytest.raises(StudyError) as caught:
        make_study(nodes={"axis": AXIS | {"parameters": array}}, parameters=PARAMETERS)
    assert str(caught.value).startswith("nodes.axis.parameters.covariance")
    assert problem in str(caught.value)


@pytest.mark.parametrize(
    ("pair", "problem"),
    [
        (["use_feedforward", "twin"], "'use_feedforward' is a boolean, which has no order"),
        (["covariance[3]", "rate"], "'rate' has a step; a parameter with an order has none"),
    ],
)
def test_what_has_no_order(make_study, pair, problem):
    twin = {"twin": NODE | {"type": "boolean", "default": True}}
    with pytest.raises(StudyError, match=problem):
        make_study(nodes={"axis": AXIS}, parameters=PARAMETERS | twin, order=[pair])
