"""Choices that are lists: text in trials, and lists wherever their values go."""

import json

import pytest

import bo_tuner as bt
from bo_tuner.errors import StudyError
from bo_tuner.storage.parameter_file import from_yaml, node_values, to_yaml
from bo_tuner.storage.parameter_set_file import read_parameter_set
from bo_tuner.storage.record import read_run
from bo_tuner.study.descriptors import Described, problem
from bo_tuner.study.other_space import with_fixed
from bo_tuner.study.parameter import Parameter
from bo_tuner.study.safe_values import named_safe
from bo_tuner.study.search_space import SearchSpace
from bo_tuner.study.study_file import parse_study, study_to_yaml

WEIGHTS = [[1.0, 2.0], [0.5, 1e-05, 4.0], [3.0]]
SECOND = json.dumps(WEIGHTS[1])


def parameter(**given):
    lists = {"type": "double_array", "choices": WEIGHTS, "default": [1, 2]}
    return Parameter(name="weights", **lists | given)


@pytest.fixture
def study(make_study):
    """A study whose default has the first list, and whose machine is safe with the second."""
    weights = {"node": "axis", "type": "double_array", "choices": WEIGHTS, "default": WEIGHTS[0]}
    gain = {"node": "axis", "type": "double", "bounds": [0, 1], "default": 0.5}
    return make_study(
        parameters={"weights": weights, "gain": gain},
        park={"parameters": {"weights": WEIGHTS[1]}},
        start=["default", {"weights": WEIGHTS[2]}],
    )


def test_any_two_are_equally_far_apart():
    space = SearchSpace([parameter()])
    assert space.levels == (3,)
    steps = [step["weights"] for step in space.integer_neighbours(space.defaults)]
    assert [json.loads(text) for text in steps] == WEIGHTS[1:]


@pytest.mark.parametrize(
    ("kind", "choices"),
    [
        ("integer_array", [[1, 2], [2, 1]]),
        ("boolean_array", [[True], [False, True]]),
        ("string_array", [["a", 'ö"'], ["1.0", ""]]),
    ],
)
def test_lists_of_every_type(kind, choices):
    item = parameter(type=kind, choices=choices, default=choices[1])
    assert repr([item.as_sent(text) for text in item.choices]) == repr(choices)
    assert item.checked(choices[1]) == item.checked(item.default) == item.default


def test_nodes_have_lists(study):
    first = study.search_space().defaults
    assert study.node_parameters(first)["axis"] == {"weights": (1.0, 2.0), "gain": 0.5}
    assert study.starting_sets()[1]["weights"] == "[3.0]"
    assert study.safe_parameters["weights"] == SECOND
    safe = named_safe(study, {"axis": {"weights": WEIGHTS[0], "gain": 0.5}})
    assert safe == {"axis": {"weights": WEIGHTS[1]}}
    assert named_safe(study, {"axis": {"weights": WEIGHTS[1], "gain": 0.5}}) == {"axis": {}}
    assert with_fixed(study, {"weights": WEIGHTS[2]}).parameters["weights"].fixed == "[3.0]"


def test_a_study_is_read_as_it_was_written(study):
    assert parse_study(study_to_yaml(study)) == study


def test_a_parameter_file_has_arrays(study, tmp_path):
    values = node_values(study, {"weights": SECOND, "gain": 0.25})
    (of_node,) = values.values()
    assert of_node["weights"] == WEIGHTS[1]
    assert from_yaml(to_yaml(values)) == values
    path = tmp_path / "best.yaml"
    path.write_text(to_yaml(values))
    assert read_parameter_set(path, study) == {"weights": SECOND, "gain": 0.25}
    path.write_text("weights: [3.0]\n")
    assert read_parameter_set(path, study) == {"weights": "[3.0]"}


def test_a_file_with_another_list_is_refused(study, tmp_path):
    path = tmp_path / "other.yaml"
    path.write_text("axis:\n  ros__parameters:\n    gain: 0.5\n    weights: [7.0]\n")
    with pytest.raises(
        StudyError, match=r"other\.yaml: weights: expected one of .*, found \[7\.0\]"
    ):
        read_parameter_set(path, study)


def test_a_function_gets_lists(tmp_path):
    parameters = {
        "weights": bt.Choice(WEIGHTS, default=WEIGHTS[0]),
        "gain": bt.Double(0, 1, default=0.5, when={"weights": SECOND}),
    }
    study = bt.Study(
        name="lists",
        parameters=parameters,
        metrics=["cost"],
        objective="cost",
        budget=bt.Budget(trials=6, initial_trials=6),
    )
    seen = []

    def total(given, context, seed):
        seen.append(given["weights"])
        # There is a gain with the second list only.
        assert ("gain" in given) == (given["weights"] == WEIGHTS[1])
        return {"cost": sum(given["weights"])}

    result = study.optimize(total, progress=False)
    assert all(weights in seen for weights in WEIGHTS)
    assert result.best["weights"] == WEIGHTS[0] or sum(result.best["weights"]) <= 3.0
    with study.tuner(tmp_path / "run") as tuner:
        run = tuner.ask()
        assert run.parameters["weights"] == WEIGHTS[0]
        # The gain is not there, neither as asked nor as set.
        tuner.tell(run, {"cost": 1.0}, parameters={"weights": WEIGHTS[2]})
    (evaluation,) = read_run(tmp_path / "run").evaluations
    assert evaluation.outcome.notes.as_set == {"weights": "[3.0]"}


@pytest.mark.parametrize(
    ("given", "kind"),
    [
        ([[1, 2], [3]], "integer_array"),
        ([[1, 2.5], [3]], "double_array"),
        ([["a"], ["b"]], "string_array"),
    ],
)
def test_the_type_in_python_is_that_of_the_items(given, kind):
    assert bt.Choice(given, default=given[0]).mapping["type"] == kind


def test_a_node_with_another_type_is_named():
    item = parameter(node="node")
    assert problem(item, {"weights": Described("double_array", WEIGHTS[0])}) == ""
    assert problem(item, {"weights": Described("integer_array", [1])}) == (
        "'weights' is of type integer_array in the node, not double_array"
    )


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"choices": [[1.0, "a"], [2.0]]}, "choices[0][1]: expected a number, found text 'a'"),
        ({"choices": [[1.0], [[2.0]]]}, "choices[1][0]: expected a number, found a list of 1"),
        ({"choices": [[1.0], []]}, "choices[1]: expected at least one item in the list"),
        ({"choices": [[1.0], [1]]}, "choices: expected a list of two or more different values"),
        ({"choices": [[1.0], 2.0]}, "choices[1]: expected a list, as it is a double_array, found"),
        (
            {"default": [3.5]},
            "default: expected one of [1.0, 2.0], [0.5, 1e-05, 4.0], [3.0], found [3.5]",
        ),
        ({"default": "[1.0"}, "default: expected a list, as it is a double_array, found text"),
        ({"ordered": True}, "ordered: lists have no order; leave it out"),
        ({"type": "double"}, "type: expected double_array, or such, for choices that are lists"),
        ({"node": "n", "parameter": "a[3]"}, "type: an item of an array is no list"),
    ],
)
def test_what_lists_cannot_be(given, said):
    with pytest.raises(StudyError) as caught:
        parameter(**given)
    assert str(caught.value).startswith(said)
