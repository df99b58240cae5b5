"""Conditions between parameters: what they permit, and every way to a parameter set keeps them."""

import numpy as np
import pytest
from functions import make_study

from bo_tuner.errors import ConditionError, StudyError
from bo_tuner.method_names import SAFE
from bo_tuner.methods.registry import METHODS
from bo_tuner.optimizers.base import INITIAL
from bo_tuner.report.grid import permitted
from bo_tuner.study.other_space import with_bounds
from bo_tuner.study.parameter import Parameter
from bo_tuner.study.search_space import STEP, SearchSpace
from bo_tuner.study.study_file import parse_study, study_to_yaml


def double(name, lower, upper, default, **fields):
    return Parameter(
        name=name, node="n", type="double", bounds=(lower, upper), default=default, **fields
    )


def integer(name, lower, upper, default, **fields):
    return Parameter(
        name=name, node="n", type="integer", bounds=(lower, upper), default=default, **fields
    )


def text(name, *choices):
    return Parameter(name=name, node="n", type="string", choices=choices, default=choices[0])


def boolean(name):
    return Parameter(name=name, node="n", type="boolean", default=False)


KP = double("kp", 0.0, 4.0, 2.0)
KI = double("ki", 0.0, 4.0, 0.5)
# Each with the same rule in Python, which the product does not see.
SPACES = {
    "half": ([KP, KI], ["ki <= kp / 2"], lambda v: v["ki"] <= v["kp"] / 2),
    "gap": (
        [double("min", 0.0, 1.0, 0.2), double("max", 0.0, 1.0, 0.8)],
        ["max > min + 0.1"],
        lambda v: v["max"] > v["min"] + 0.1,
    ),
    "sum": (
        [double(name, 0.0, 1.0, 0.1) for name in "abcd"],
        ["a + b <= 1", "a + b + c + d <= 1"],
        lambda v: sum(v.values()) <= 1,
    ),
    "log": (
        [double("q", 1e-6, 1.0, 1e-3, scale="log"), double("r", 1e-6, 1.0, 1e-1, scale="log")],
        ["q < r / 10"],
        lambda v: v["q"] < v["r"] / 10,
    ),
    "steps": (
        [double("x", 0.0, 1.0, 0.25, step=0.25), integer("n", 0, 12, 4, step=4)],
        ["x * n >= 1"],
        lambda v: v["x"] * v["n"] >= 1,
    ),
    "equal_integers": (
        [integer("a", 1, 10, 5), integer("b", 1, 10, 3)],
        ["a + b == 8"],
        lambda v: v["a"] + v["b"] == 8,
    ),
    "choices": (
        [text("mode", "slow", "fast", "wild"), double("gain", 0.0, 1.0, 0.9), boolean("smooth")],
        ["mode == 'slow' or gain < 0.3", "smooth or mode != 'wild'"],
        lambda v: (v["mode"] == "slow" or v["gain"] < 0.3)
        and (v["smooth"] or v["mode"] != "wild"),
    ),
    "apart": (
        [double("x", 0.0, 1.0, 0.05), double("y", 0.0, 1.0, 0.5)],
        ["x < 0.1 or x > 0.95"],
        lambda v: v["x"] < 0.1 or v["x"] > 0.95,
    ),
    "levels": (
        [double("gains.kp", 0.0, 4.0, 2.0), double("limits[1]", 0.0, 4.0, 0.5)],
        ["limits[1] <= gains.kp / 2"],
        lambda v: v["limits[1]"] <= v["gains.kp"] / 2,
    ),
    "undefined": (
        [double("x", 0.0, 1.0, 0.5), integer("n", -1, 1, 1)],
        ["x / n >= 0"],
        lambda v: v["n"] == 1 or (v["n"] == -1 and v["x"] == 0.0),
    ),
    "with_order": (
        [double("x", 0.0, 1.0, 0.1), double("y", 0.0, 1.0, 0.3)],
        ["x + y <= 1"],
        lambda v: v["x"] <= v["y"] and v["x"] + v["y"] <= 1,
    ),
}  # fmt: skip


def space_of(name):
    parameters, where, _ = SPACES[name]
    return SearchSpace(parameters, [("x", "y")] if name == "with_order" else [], where)


@pytest.fixture(params=SPACES)
def case(request):
    return space_of(request.param), SPACES[request.param][2]


class TestEveryWay:
    def test_repair(self, case):
        space, rule = case
        positions = np.random.default_rng(0).normal(0.5, 0.7, (300, space.dimension))
        repaired = space.repair(positions)
        assert np.all((repaired >= 0.0) & (repaired <= 1.0))
        assert all(rule(space.to_parameters(row)) for row in [*positions, *repaired])
        np.testing.assert_allclose(space.repair(repaired), repaired, atol=1e-8)

    def test_what_is_permitted_stays(self, case):
        space, rule = case
        points = np.random.default_rng(1).random((300, space.dimension))
        free = SearchSpace(space.parameters, space.order).repair(points)
        kept = [rule(SearchSpace(space.parameters, space.order).to_parameters(p)) for p in free]
        assert any(kept)
        np.testing.assert_array_equal(space.repair(points)[kept], free[kept])

    @pytest.mark.parametrize("count", [1, 7, 200])
    def test_designs(self, case, count):
        space, rule = case
        points = space.latin_hypercube(count, np.random.default_rng(count))
        assert len(points) == count
        assert all(rule(space.to_parameters(point)) for point in points)

    def test_neighbours(self, case):
        space, rule = case
        for point in space.latin_hypercube(20, np.random.default_rng(3)):
            at = space.to_parameters(point)
            around = [*space.neighbours(at), *space.integer_neighbours(at)]
            assert all(rule(other) for other in around)
            assert all(other != at for other in around)


def test_a_repair_moves_no_farther_than_it_must():
    """From outside a half-plane to its edge, nearly at right angles."""
    space = space_of("half")
    positions = np.random.default_rng(0).random((200, 2))
    outside = positions[positions[:, 1] > positions[:, 0] / 2]
    moved = space.repair(outside)
    np.testing.assert_allclose(moved[:, 1], moved[:, 0] / 2, atol=1e-6)
    # The distance of a point from the line 2 y = x.
    shortest = (2 * outside[:, 1] - outside[:, 0]) / np.sqrt(5)
    walked = np.linalg.norm(moved - outside, axis=1)
    assert np.all(walked >= shortest - 1e-9)
    assert np.median(walked / shortest) < 1.05


def test_a_design_fills_what_is_permitted():
    """Evenly by area, which of a triangle is a quarter left of the middle."""
    space = space_of("half")
    kp = 4.0 * space.latin_hypercube(2000, np.random.default_rng(0))[:, 0]
    assert np.mean(kp < 2.0) == pytest.approx(0.25, abs=0.04)


def test_a_neighbour_ends_where_a_condition_begins():
    space = SearchSpace([KP, KI], where=["ki <= kp / 2"])
    at = {"kp": 1.0, "ki": 0.4}
    found = space.neighbours(at)
    step = 4.0 * STEP
    lower_kp, higher_kp, lower_ki, higher_ki = found
    assert lower_kp == {"kp": pytest.approx(0.8), "ki": 0.4}
    assert higher_kp == {"kp": pytest.approx(1.0 + step), "ki": 0.4}
    assert lower_ki == {"kp": 1.0, "ki": pytest.approx(0.4 - step)}
    assert higher_ki == {"kp": 1.0, "ki": pytest.approx(0.5)}


def test_no_neighbour_beyond_the_edge():
    """At the edge the two steps that would leave it are none."""
    space = SearchSpace([KP, KI], where=["ki <= kp / 2"])
    found = space.neighbours({"kp": 1.0, "ki": 0.5})
    assert [n for n in found if n["ki"] > 0.5 or n["kp"] < 1.0] == []
    assert len(found) == 2


def test_tied_and_fixed_parameters_count():
    parameters = [
        KP,
        Parameter(name="twin", node="n", type="double", tied_to="kp"),
        Parameter(name="top", node="n", type="double", fixed=2.5),
        Parameter(name="kind", node="n", type="string", fixed="pid"),
    ]
    space = SearchSpace(parameters, where=["twin <= top", "kind == 'pid'"])
    assert space.repair([[1.0]])[0, 0] * 4.0 == pytest.approx(2.5)
    with pytest.raises(ConditionError, match=r"'twin <= top': twin 3.0 and top 2.5"):
        space.permitted({"kp": 3.0})


NODE = {"node": "axis"}
PARAMETERS = {
    "kp": NODE | {"type": "double", "bounds": [0.0, 4.0], "default": 2.0},
    "ki": NODE | {"type": "double", "bounds": [0.0, 4.0], "default": 0.5},
    "steps": NODE | {"type": "integer", "bounds": [1, 4], "default": 2},
}
WHERE = ["ki <= kp / 2", "steps * kp <= 6"]


def kept(values):
    return values["ki"] <= values["kp"] / 2 and values["steps"] * values["kp"] <= 6


def study_with(**sections):
    sections = {"parameters": PARAMETERS, "where": WHERE} | sections
    return make_study(**sections)


class TestProposals:
    @pytest.mark.parametrize("algorithm", METHODS)
    def test_of_every_algorithm(self, make_trial, algorithm):
        """The best is beyond both conditions, where each search would go."""
        budget = {"trials": 12, "initial_trials": 5, "drawn_contexts": 2, "search_evaluations": 2}
        study = study_with(budget=budget | {"validation_draws": 5}, start=["default"])
        optimizer = METHODS[algorithm].optimizer(study)
        found = []
        for number in range(12):
            proposal = optimizer.ask()
            found.append(proposal)
            values = proposal.parameters
            cost = (values["ki"] - 4.0) ** 2 + (values["kp"] - 1.0) ** 2
            optimizer.tell(make_trial(number, values, [cost, cost + 0.1], 0.5))
        assert all(kept(proposal.parameters) for proposal in found)
        # A safe search has no initial design.
        assert [p.origin for p in found].count(INITIAL) == (0 if algorithm == SAFE else 4)
        assert len({tuple(p.parameters.values()) for p in found}) == 12

    def test_points_of_figures(self):
        study = study_with()
        points = np.random.default_rng(0).random((200, 3))
        points = SearchSpace(study.parameters.values()).repair(points)
        sets = [SearchSpace(study.parameters.values()).to_parameters(p) for p in points]
        np.testing.assert_array_equal(permitted(study, points), [kept(each) for each in sets])


class TestRefused:
    @pytest.mark.parametrize(
        ("where", "refusal"),
        [
            ("ki <= kp", "where: expected a list of conditions such as ki <= kp / 2, found text"),
            ([3], "where[0]: expected text, found 3"),
            (["ki <= kd"], "where[0]: there is no parameter or function 'kd'; expected one of kp"),
            (["ki <= gains.kp"], "where[0]: "),
            (["ki <="], "where[0]: not an expression: something is missing at its end"),
            (["ki =< kp"], "where[0]: not an expression: expected <= instead of =<"),
            (["ki + kp"], "where[0]: expected a condition such as ki <= kp / 2, found 'ki + kp'"),
            (["1 < 2"], "where[0]: there is no parameter in '1 < 2'"),
            (["ki < 'a'"], "where[0]: cannot be evaluated: expected a number instead of 'a'"),
            (
                ["kp / 0 <= 1"],
                "where[0]: 'kp / 0 <= 1' is not defined for any parameter set within the bounds; "
                "is there a division by zero?",
            ),
            (
                ["ki <= kp / (steps - 2)"],
                "where[0]: the default breaks the condition 'ki <= kp / (steps - 2)': it is not "
                "defined for kp 2.0, ki 0.5 and steps 2",
            ),
            (
                ["kp <= ki"],
                "where[0]: the default breaks the condition 'kp <= ki': kp 2.0 and ki 0.5",
            ),
            (
                ["kp < 0"],
                "where[0]: 'kp < 0' holds for none of the parameter sets within the bounds, of "
                "which 65536 were drawn; expected at least 0.01 %",
            ),
            (
                ["kp == 2 * ki"],
                "where[0]: 'kp == 2 * ki' does not hold for the defaults: ki is 0.5, where the "
                "others leave 1",
            ),
            (
                ["kp + ki < 4", "ki < kp", "steps > 1", "ki > kp + 1"],
                "where[3]: 'ki < kp' and 'ki > kp + 1' hold together for none",
            ),
            (
                ["kp < 0.03"],
                "where[0]: the default breaks the condition 'kp < 0.03': kp 2.0",
            ),
            (["kp < 1"] * 51, "where: expected at most 50 entries, found 51"),
        ],
    )
    def test_in_a_line(self, where, refusal):
        with pytest.raises(StudyError) as error:
            study_with(where=where)
        assert str(error.value).startswith(refusal)
        assert "\n" not in str(error.value)

    @pytest.mark.parametrize(
        ("where", "refusal"),
        [
            ("mode > 1", "where[0]: 'mode' is a text; compare it by == or != with 'a' or 'b'"),
            ("mode", "where[0]: 'mode' is a text"),
            ("mode + kp < 3", "where[0]: 'mode' is a text"),
            ("mode in ('a', 'b')", "where[0]: 'mode' is a text"),
            ("mode == 'c'", "where[0]: unknown 'c'; expected one of a, b"),
        ],
    )
    def test_of_texts(self, where, refusal):
        mode = NODE | {"type": "string", "choices": ["a", "b"], "default": "a"}
        with pytest.raises(StudyError) as error:
            study_with(parameters=PARAMETERS | {"mode": mode}, where=[where])
        assert str(error.value).startswith(refusal)

    def test_a_small_share_is_told(self):
        names = "abcdefg"
        parameters = {
            name: NODE | {"type": "double", "bounds": [0.0, 1.0], "default": 0.01} for name in names
        }
        # The volume below a sum of s is s^7 / 7!.
        with pytest.raises(StudyError, match=r"for (only .* %|none) of the parameter sets"):
            make_study(parameters=parameters, where=[f"{' + '.join(names)} <= 0.5"])
        assert make_study(parameters=parameters, where=[f"{' + '.join(names)} <= 1.2"])

    @pytest.mark.parametrize("key", ["start", "park"])
    def test_sets_that_the_study_names(self, key):
        broken = {"kp": 1.0, "ki": 3.0}
        section = [broken] if key == "start" else {"parameters": broken}
        with pytest.raises(StudyError) as error:
            study_with(**{key: section})
        where = "start[0]" if key == "start" else "park.parameters"
        assert str(error.value) == (
            f"{where}: breaks the condition 'ki <= kp / 2': kp 1.0 and ki 3.0"
        )

    def test_other_bounds_that_leave_nothing(self):
        study = study_with(where=["ki <= kp / 2"])
        with pytest.raises(StudyError, match=r"where\[0\]: 'ki <= kp / 2' holds for "):
            with_bounds(study, {"ki": (0.5, 1e6)})


def test_a_study_file_keeps_them():
    study = study_with()
    assert study.where == tuple(WHERE)
    assert parse_study(study_to_yaml(study)).where == study.where


def test_the_default_itself_may_be_at_the_edge():
    study = study_with(where=["ki <= kp / 4"])
    space = study.search_space()
    assert space.permitted(space.defaults) == space.defaults
    assert study.starting_sets() == []
