"""Parameters that are an expression of others."""

import dataclasses

import numpy as np
import pytest

from bo_tuner.errors import ConditionError, StudyError
from bo_tuner.study.descriptors import Described, problem
from bo_tuner.study.parameter import Parameter
from bo_tuner.study.search_space import SearchSpace

KP = Parameter(name="kp", type="double", bounds=[0.0, 10.0], default=2.0)
HORIZON = Parameter(name="horizon", type="integer", bounds=[1, 9], default=3)
MODE = Parameter(name="mode", type="string", choices=["a", "b"], default="a")


def derived(expression, name="x", **given):
    return Parameter(name=name, **{"type": "double", "tied_to": expression, **given})


def drawn(space):
    points = space.latin_hypercube(60, np.random.default_rng(3))
    return [space.to_parameters(point) for point in points]


def test_it_follows_the_others_in_every_set():
    space = SearchSpace([KP, HORIZON, derived("0.1 * kp + horizon")])
    assert space.names == ("kp", "horizon")
    assert space.defaults == {"kp": 2.0, "horizon": 3, "x": 3.2}
    assert all(each["x"] == 0.1 * each["kp"] + each["horizon"] for each in drawn(space))


def test_an_integer_is_the_nearest_one():
    space = SearchSpace([KP, derived("kp / 2", type="integer", bounds=[0, 5])])
    assert [space.completed({"kp": kp})["x"] for kp in (2.9, 3.1, 10.0)] == [1, 2, 5]
    assert type(space.defaults["x"]) is int


def test_its_bounds_and_conditions_on_it_are_kept():
    space = SearchSpace(
        [KP, HORIZON, derived("kp * horizon", bounds=[4.0, 20.0])], where=["x > kp"]
    )
    assert all(4.0 <= each["x"] <= 20.0 and each["x"] > each["kp"] for each in drawn(space))
    with pytest.raises(ConditionError, match=r"4.0 <= x <= 20.0.*x 30"):
        space.permitted({"kp": 10.0, "horizon": 3})


def test_a_set_for_which_it_is_not_defined_is_not_permitted():
    space = SearchSpace([KP, derived("1 / kp")])
    with pytest.raises(ConditionError, match="not defined"):
        space.permitted({"kp": 0.0})
    assert space.to_parameters([0.0])["kp"] > 0.0


def test_it_may_be_conditional():
    kp = dataclasses.replace(KP, when={"mode": "b"})
    space = SearchSpace([MODE, kp, derived("1 / kp", when={"mode": "b"})])
    assert space.active(space.completed({"mode": "a"})) == {"mode": "a"}
    assert space.active(space.completed({"mode": "b", "kp": 4.0}))["x"] == 0.25


def test_a_node_must_take_its_bounds():
    item = derived("2 * kp", node="pid", bounds=[0.0, 3.0])
    described = Described("double", 1.0, lower=0.0, upper=2.0)
    assert "3" in problem(item, {"x": described})
    assert not problem(item, {"x": dataclasses.replace(described, upper=3.0)})


def test_a_set_of_a_user_may_have_it(make_study):
    node = {"node": "axis", "type": "double"}
    study = make_study(
        parameters={
            "kp": node | {"bounds": [0.0, 1.0], "default": 0.1},
            "ki": node | {"tied_to": "3 * kp"},
        }
    )
    assert study.complete_set({"kp": 0.1, "ki": 0.3})["ki"] == pytest.approx(0.3)
    with pytest.raises(StudyError, match=r"ki: expected 0.3.*, as the study sets it, found 0.5"):
        study.complete_set({"kp": 0.1, "ki": 0.5})
    assert study.node_parameters({"kp": 0.2, "ki": 0.6})["axis"] == {"kp": 0.2, "ki": 0.6}


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (
            {"tied_to": "2 * kq"},
            "parameters.x.tied_to: there is no number or function 'kq'; expected one of kp, "
            "horizon, x",
        ),
        ({"tied_to": "2 * x"}, "parameters.x.tied_to: 'x' is itself computed from others"),
        (
            {"tied_to": "2 *"},
            "parameters.x.tied_to: not an expression: something is missing at its end, in '2 *'",
        ),
        (
            {"tied_to": "kp", "bounds": [0, 1]},
            "bounds: a tied parameter has no bounds; leave it out",
        ),
        (
            {"tied_to": "2 * kp", "default": 4.0},
            "default: a parameter that is computed from others has no default; leave it out",
        ),
        (
            {"tied_to": "2 * kp", "bounds": [0.0, 3.0]},
            "parameters.x.tied_to: the default breaks the condition '0.0 <= x <= 3.0': x 4",
        ),
        (
            {"tied_to": "2 * kp", "type": "integer"},
            "parameters.x.bounds: missing; an integer that is computed has them",
        ),
        (
            {"tied_to": "2 * kp", "type": "boolean"},
            "tied_to: a boolean is no expression of others",
        ),
    ],
)
def test_what_cannot_be(given, said):
    with pytest.raises(StudyError) as caught:
        SearchSpace([KP, HORIZON, derived(given.pop("tied_to"), **given)])
    assert str(caught.value).startswith(said)


def test_it_is_not_computed_from_what_is_conditional():
    kp = dataclasses.replace(KP, when={"mode": "b"})
    with pytest.raises(StudyError, match=r"tied_to: 'kp' is there only when mode == 'b'"):
        SearchSpace([MODE, HORIZON, kp, derived("2 * kp")])


def test_an_order_of_it_is_a_condition():
    with pytest.raises(StudyError, match="'x' is computed; expected it in `where`"):
        SearchSpace([KP, HORIZON, derived("2 * kp")], order=[("kp", "x")])
