"""Choices of numbers, in an order or without one, and steps that are a factor."""

import numpy as np
import pytest

import bo_tuner as bt
from bo_tuner.errors import ParameterError, StudyError
from bo_tuner.study.descriptors import Described, problem
from bo_tuner.study.parameter import Parameter
from bo_tuner.study.search_space import SearchSpace


def parameter(name="k", **given):
    return Parameter(name=name, **{"type": "integer", **given})


BATCH = parameter(choices=[50, 100, 200], default=100)
UNORDERED = parameter("u", choices=[200, 50, 100, 7], ordered=False, default=100)


def test_an_ordered_choice_lies_at_its_place_between_the_first_and_the_last():
    space = SearchSpace([BATCH])
    assert [space.to_cube({"k": value})[0] for value in (50, 100, 200)] == [0.0, 0.5, 1.0]
    assert [space.to_parameters([at])["k"] for at in (0.0, 0.24, 0.26, 0.76)] == [50, 50, 100, 200]
    # Models see one number.
    assert space.levels == (0,)
    assert SearchSpace([UNORDERED]).levels == (4,)


def test_numbers_that_decrease_have_an_order_as_well():
    space = SearchSpace([parameter(choices=[200, 100, 50], default=100)])
    assert [space.to_cube({"k": value})[0] for value in (200, 100, 50)] == [0.0, 0.5, 1.0]
    assert parameter(choices=[100, 200, 50], default=100).ordered is False


def test_neighbours_are_the_next_ones_in_an_order_and_all_others_without_one():
    space = SearchSpace([BATCH, UNORDERED])
    steps = space.integer_neighbours({"k": 50, "u": 100})
    assert [step["k"] for step in steps if step["u"] == 100] == [100]
    assert {step["u"] for step in steps if step["k"] == 50} == {200, 50, 7}
    assert len(space.integer_neighbour_points({"k": 100, "u": 100})) == 2


def test_all_are_equally_likely():
    space = SearchSpace([BATCH, UNORDERED, parameter("x", type="double", bounds=[0, 1], default=0)])
    points = space.latin_hypercube(120, np.random.default_rng(0))
    drawn = [space.to_parameters(point) for point in points]
    for item in (BATCH, UNORDERED):
        counts = [sum(each[item.name] == value for each in drawn) for value in item.choices]
        assert counts == [120 / len(item.choices)] * len(item.choices)


def test_texts_in_an_order():
    text = parameter(
        "t", type="string", choices=["low", "mid", "high"], ordered=True, default="mid"
    )
    space = SearchSpace([text])
    assert space.levels == (0,)
    assert [step["t"] for step in space.integer_neighbours({"t": "low"})] == ["mid"]


def test_a_factor_gives_its_powers():
    gain = parameter(type="double", bounds=[0.5, 100], step="2x", default=4)
    assert gain.choices == tuple(0.5 * 2.0**k for k in range(8))
    assert gain == parameter(type="double", choices=gain.choices, default=4.0)
    size = parameter(bounds=[1, 1000], step="10x", default=10)
    assert (size.choices, {type(value) for value in size.choices}) == ((1, 10, 100, 1000), {int})


def test_a_condition_compares_the_values():
    """Not their positions."""
    x = parameter("x", type="double", bounds=[0, 300], default=0)
    space = SearchSpace([BATCH, x], where=["x <= k"])
    drawn = [space.to_parameters(p) for p in space.latin_hypercube(50, np.random.default_rng(1))]
    assert all(each["x"] <= each["k"] for each in drawn)
    assert max(each["x"] for each in drawn) > 100.0
    with pytest.raises(ParameterError, match="breaks the condition"):
        space.permitted({"k": 50, "x": 60.0})


def test_a_parameter_tied_to_one_follows_it():
    echo = parameter("echo", tied_to="k")
    assert SearchSpace([BATCH, echo]).completed({"k": 200}) == {"k": 200, "echo": 200}


def test_a_study_in_python_and_its_file(tmp_path):
    study = bt.Study(
        name="sizes",
        parameters={
            "batch": bt.Choice([50, 100, 200], default=100),
            "rate": bt.Choice([0.1, 1], default=1, ordered=False),
            "solver": bt.Choice(["a", "b"], default="a"),
        },
        metrics=["error"],
        objective="error",
        budget=bt.Budget(trials=4, initial_trials=4),
    )
    parameters = study.checked.parameters
    assert [item.type for item in parameters.values()] == ["integer", "double", "string"]
    assert [item.has_order for item in parameters.values()] == [True, False, False]
    (tmp_path / "study.yaml").write_text(study.to_yaml())
    assert bt.Study.from_yaml(tmp_path / "study.yaml") == study


def test_one_outside_the_range_of_the_node():
    known = {"k": Described("integer", 100, 0, 150)}
    item = parameter(node="node", choices=[50, 100, 200], default=100)
    assert problem(item, known) == "200 lies outside the range of 'k' in the node, [0, 150]"


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"default": 75}, "default: expected one of 50, 100, 200, found 75"),
        ({"choices": [50, 100.5]}, "choices[1]: expected an integer, found 100.5"),
        ({"choices": [100]}, "choices: expected a list of two or more different values"),
        ({"choices": [100, 100]}, "choices: expected a list of two or more different values"),
        (
            {"choices": [200, 50, 100], "ordered": True},
            "choices: expected numbers that increase or decrease, or ordered: false",
        ),
        ({"bounds": [50, 200]}, "bounds: a parameter with choices has no bounds; leave it out"),
        ({"scale": "log"}, "scale: a parameter with choices has no scale; leave it out"),
        ({"step": "2x"}, "step: belongs to a number with bounds; leave it out"),
    ],
)
def test_what_choices_cannot_be(given, said):
    with pytest.raises(StudyError) as caught:
        parameter(**{"choices": [50, 100, 200], "default": 100} | given)
    assert str(caught.value).startswith(said)


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"bounds": [0, 100]}, "bounds: a factor needs bounds above 0; 2x times 0 is 0"),
        ({"bounds": [1, "a"]}, "bounds[1]: expected a number, found text 'a'"),
        ({"step": "1x"}, "step: expected a number, or a factor above 1 such as 2x, found text"),
        ({"step": "two"}, "step: expected a number, or a factor above 1 such as 2x, found text"),
        ({"step": "1.5x"}, "step: expected integers only, found 1.5, a power of 1.5x times 1"),
        ({"bounds": [1, 10**18]}, "step: gives more than 50 values"),
        ({"default": 3}, "default: expected one of 1, 2, 4, 8, found 3"),
        ({"step": None, "ordered": True}, "ordered: belongs to choices; leave it out"),
    ],
)
def test_what_a_factor_cannot_be(given, said):
    with pytest.raises(StudyError) as caught:
        parameter(**{"bounds": [1, 10], "step": "2x", "default": 1} | given)
    assert str(caught.value).startswith(said)


def test_a_choice_has_no_order_with_another_parameter():
    with pytest.raises(StudyError, match="'k' has choices, and is compared with no other"):
        SearchSpace([BATCH, parameter("n", bounds=[1, 9], default=3)], order=[("n", "k")])
