"""Linear equalities of tuned doubles."""

import numpy as np
import pytest
from scipy.stats import beta, kstest

import bo_tuner as bt
from bo_tuner.errors import ConditionError, StudyError
from bo_tuner.methods.safe.safe_set import Reach
from bo_tuner.study.parameter import Parameter
from bo_tuner.study.search_space import SearchSpace
from bo_tuner.trials import Trial, TrialState


def parameter(name, **given):
    return Parameter(
        name=name, **{"type": "double", "bounds": [0.0, 1.0], "default": 0.25, **given}
    )


A, B, C = parameter("a"), parameter("b"), parameter("c", default=0.5)
SUM = "a + b + c == 1"
Z = parameter("z", bounds=[1.0, 100.0], default=10.0, scale="log")


def drawn(space, count=200):
    points = space.latin_hypercube(count, np.random.default_rng(1))
    return [space.to_parameters(point) for point in points]


def test_the_last_one_follows_from_the_others():
    space = SearchSpace([A, B, C, Z], where=[SUM])
    assert space.names == ("a", "b", "z")
    assert list(space.defaults) == ["a", "b", "c", "z"]
    assert space.completed({"a": 0.1, "b": 0.6, "z": 5.0})["c"] == 0.3
    assert all(each["a"] + each["b"] + each["c"] == pytest.approx(1.0) for each in drawn(space))


def test_nine_components_are_drawn_uniformly_and_the_rest_as_before():
    components = [parameter(f"w{k}", default=1 / 9) for k in range(9)]
    space = SearchSpace([*components, Z], where=[" + ".join(c.name for c in components) + " == 1"])
    sets = drawn(space, 1000)
    for item in components:
        assert kstest([each[item.name] for each in sets], beta(1, 8).cdf).pvalue > 1e-3
    # One in each of as many strata.
    strata = np.floor(np.log(sorted(each["z"] for each in sets)) / np.log(100.0) * 1000 + 1e-3)
    assert np.abs(strata - np.arange(1000)).max() <= 1


def test_points_beyond_the_plane_are_moved_to_the_nearest_set():
    space = SearchSpace([A, B, C], where=[SUM])
    assert space.repair([[1.0, 1.0], [0.9, 0.5]]) == pytest.approx(
        np.array([[0.5, 0.5], [0.7, 0.3]])
    )
    inside = np.array([[0.2, 0.7], [0.0, 1.0]])
    assert np.array_equal(space.repair(inside), inside)
    for near in space.neighbours(space.defaults):
        assert near["a"] + near["b"] + near["c"] == pytest.approx(1.0)
    # One that is at a bound can only go in.
    assert min(near["c"] for near in space.neighbours({"a": 0.5, "b": 0.5})) == 0.0


def test_other_bounds_and_coefficients():
    a = parameter("a", bounds=[-1.0, 3.0])
    fixed = Parameter(name="f", type="double", fixed=2.0)
    space = SearchSpace([a, B, C, fixed], where=["2 * a - b == f * c - 0.75"])
    for each in drawn(space):
        assert 2.0 * each["a"] - each["b"] == pytest.approx(2.0 * each["c"] - 0.75, abs=1e-9)
        assert 0.0 <= each["c"] <= 1.0
    assert {round(each["c"], 1) for each in drawn(space)} >= {0.0, 0.5, 1.0}


def test_others_may_name_what_follows():
    tied = Parameter(name="echo", type="double", tied_to="c")
    computed = Parameter(name="tenfold", type="double", tied_to="10 * c")
    space = SearchSpace([A, B, C, tied, computed], where=[SUM, "c >= a"])
    assert all(each["c"] >= each["a"] for each in drawn(space))
    for each in drawn(space):
        assert each["echo"] == each["c"]
        assert each["tenfold"] == 10.0 * each["c"]


def test_it_is_judged_as_it_is_set():
    """A run is asked for with all three, and told with what they give."""
    study = bt.Study(
        name="mixture",
        parameters={name: bt.Double(0, 1, default=1 / 3) for name in "abc"},
        metrics=["cost"],
        objective="cost",
        where=[SUM],
        budget=bt.Budget(trials=14, initial_trials=6, validation_draws=1),
        noise="none",
    )

    def cost(given, context, seed):
        assert sum(given.values()) == pytest.approx(1.0)
        return {"cost": (given["a"] - 0.7) ** 2 + (given["b"] - 0.3) ** 2 + given["c"] ** 2}

    result = study.optimize(cost, progress=False)
    assert result.best["a"] == pytest.approx(0.7, abs=0.05)
    assert result.best["c"] == pytest.approx(0.0, abs=0.05)
    assert {"parameters.a", "parameters.b", "parameters.c"} <= set(result.trials().columns)


def test_a_set_of_a_user(make_study):
    node = {"node": "axis", "type": "double", "bounds": [0, 1], "default": 0.25}
    study = make_study(parameters={"a": node, "b": node, "c": node | {"default": 0.5}}, where=[SUM])
    assert study.complete_set({"a": 0.2, "b": 0.3})["c"] == 0.5
    assert study.complete_set({"a": 0.1, "b": 0.2, "c": 0.7})
    with pytest.raises(StudyError, match=r"c: expected 0.7, as the study sets it, found 0.6"):
        study.complete_set({"a": 0.1, "b": 0.2, "c": 0.6})
    with pytest.raises(ConditionError, match=r"a 0.9, b 0.2 leave nothing within bounds to c"):
        study.search_space().permitted({"a": 0.9, "b": 0.2})
    with pytest.raises(StudyError, match=r"park.parameters.c: expected 0.5"):
        make_study(parameters=dict(study.parameters), where=[SUM], park={"parameters": {"c": 0.1}})


def test_a_safe_search_moves_none_of_them_farther_than_it_may(make_study):
    """The one that follows is the sum of what the others move."""
    node = {"node": "axis", "type": "double", "bounds": [0, 1], "default": 0.25}
    study = make_study(parameters={"a": node, "b": node, "c": node | {"default": 0.5}}, where=[SUM])
    space = study.search_space()
    kept = Trial(0, space.defaults, "", TrialState.COMPLETE)
    reach = Reach.of(study, [kept], travel=0.1, trust=1.0)
    points = reach.candidates(np.array([1.0, 0.0]), np.random.default_rng(0))
    moved = [space.to_parameters(point) for point in points]
    farthest = {
        name: max(abs(each[name] - space.defaults[name]) for each in moved) for name in "abc"
    }
    assert all(0.09 < far <= 0.1 + 1e-6 for far in farthest.values())


@pytest.mark.parametrize(
    ("parameters", "where", "said"),
    [
        (
            [A, B, C],
            ["a + b + c == 4"],
            "where[0]: 'a + b + c == 4' cannot hold: within the bounds its left side minus its "
            "right one is -4 to -1",
        ),
        (
            [A, B, parameter("c")],
            [SUM],
            "where[0]: 'a + b + c == 1' does not hold for the defaults: c is 0.25, where the "
            "others leave 0.5",
        ),
        (
            [A, parameter("b", step=0.25), C],
            [SUM],
            "where[0]: 'b' has a step; a double in an equality has none",
        ),
        (
            [A, parameter("b", when="z > 3"), C],
            [SUM],
            "where[0]: 'b' has a when; a double in an equality has none",
        ),
        (
            [A, B, C, parameter("d", default=0.5)],
            ["a + b == 0.5", "b + d == 0.75"],
            "where[1]: 'b' is in another equality as well; expected it in one",
        ),
        ([A, B, C], ["a * b == c"], "where[0]: 'a * b == c' holds for none"),
    ],
)
def test_what_cannot_be(parameters, where, said):
    with pytest.raises(StudyError) as caught:
        SearchSpace([*parameters, Z], where=where)
    assert str(caught.value).startswith(said)


def test_an_equality_of_integers_or_choices_is_a_condition():
    n, m = (parameter(name, type="integer", bounds=[0, 9], default=2) for name in "nm")
    space = SearchSpace([n, m, Z], where=["n == m"])
    assert space.names == ("n", "m", "z")
    assert all(each["n"] == each["m"] for each in drawn(space))
