"""The search space: cube to parameters and back, order, design, neighbours."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from bo_tuner.errors import ParameterError, StudyError
from bo_tuner.study.ordering import PartialOrder
from bo_tuner.study.parameter import Parameter
from bo_tuner.study.search_space import RESOLUTION, SearchSpace

few_examples = settings(max_examples=60)


def integer(name, bounds, default=None, **fields):
    default = bounds[0] if default is None else default
    return Parameter(name=name, node="n", type="integer", bounds=bounds, default=default, **fields)


def double(name, bounds, default=None, **fields):
    default = bounds[0] if default is None else default
    return Parameter(name=name, node="n", type="double", bounds=bounds, default=default, **fields)


def tied(name, to, kind="integer", **fields):
    return Parameter(name=name, node="n", type=kind, tied_to=to, **fields)


def fixed(name, value, kind="double"):
    return Parameter(name=name, node="n", type=kind, fixed=value)


def full():
    return SearchSpace(
        [
            integer("h_u", (1, 20), 15, minimum_correlation=0.1),
            integer("h_p", (1, 25), 15, minimum_correlation=0.1),
            double("l_mpc", (-5.0, 1.0), -3.0),
            double("l_kf", (-5.0, 2.0), -1.0),
        ],
        [("h_u", "h_p")],
    )


def benchmark():
    return SearchSpace(
        [
            integer("h_u", (1, 20), 15),
            tied("h_p", "h_u"),
            double("l_mpc", (-5.0, 1.0), -3.0),
            fixed("l_kf", -1.0),
        ]
    )


def chain():
    """Three integers and a constant in one chain, doubles in another."""
    return SearchSpace(
        [
            integer("c", (0, 9), 4),
            integer("a", (-3, 5), 0),
            integer("b", (2, 12), 3),
            fixed("top", 8, "integer"),
            double("x", (0.0, 1.0), 0.2),
            double("y", (-1.0, 3.0), 0.2),
        ],
        [("a", "b"), ("b", "c"), ("c", "top"), ("x", "y")],
    )


SPACES = {
    "one_integer": SearchSpace([integer("k", (0, 1))]),
    "one_double": SearchSpace([double("k", (-1.0, 1.0))]),
    "benchmark": benchmark(),
    "full": full(),
    "chain": chain(),
    "twelve": SearchSpace([double(f"x{i}", (-i - 1.0, i + 0.5)) for i in range(12)]),
}
each_space = pytest.mark.parametrize("space", SPACES.values(), ids=SPACES.keys())


def is_permitted(space, parameters):
    ordered = all(parameters[a] <= parameters[b] for a, b in space.order)
    inside = all(
        item.bounds is None or item.bounds[0] <= parameters[item.name] <= item.bounds[1]
        for item in space.parameters
    )
    types = all(
        type(parameters[item.name]) is (int if item.type == "integer" else float)
        for item in space.parameters
    )
    return ordered and inside and types


class TestMapping:
    def test_cube_corners_are_the_bounds(self):
        space = full()
        assert space.names == ("h_u", "h_p", "l_mpc", "l_kf")
        assert space.dimension == 4
        lowest, highest = (list(space.to_parameters(np.full(4, z)).values()) for z in (0.0, 1.0))
        assert lowest == [1, 1, -5.0, -5.0]
        assert highest == [20, 25, 1.0, 2.0]

    def test_tied_and_fixed_parameters_follow(self):
        parameters = benchmark().to_parameters(np.array([8 / 19, 0.5]))
        assert parameters == {"h_u": 9, "h_p": 9, "l_mpc": -2.0, "l_kf": -1.0}
        assert list(parameters) == ["h_u", "h_p", "l_mpc", "l_kf"]
        assert [type(value) for value in parameters.values()] == [int, int, float, float]

    def test_tied_to_a_fixed_parameter(self):
        space = SearchSpace([double("x", (0, 1)), fixed("a", 3, "integer"), tied("b", "a")])
        assert space.defaults == {"x": 0.0, "a": 3, "b": 3}
        assert space.to_parameters([1.0]) == {"x": 1.0, "a": 3, "b": 3}

    def test_defaults(self):
        assert benchmark().defaults == {"h_u": 15, "h_p": 15, "l_mpc": -3.0, "l_kf": -1.0}

    @each_space
    @given(data=st.data())
    @few_examples
    def test_round_trip(self, space, data):
        cube = data.draw(arrays(float, space.dimension, elements=st.floats(-0.5, 1.5)))
        parameters = space.to_parameters(cube)
        assert is_permitted(space, parameters)
        point = space.to_cube(parameters)
        assert np.all((point >= 0.0) & (point <= 1.0))
        again = space.to_parameters(point)
        assert again == pytest.approx(parameters, rel=1e-12, abs=1e-12)
        assert space.key(again) == pytest.approx(space.key(parameters), abs=2e-5)
        # Half of the decimal place that a double is rounded to.
        np.testing.assert_allclose(space.repair(cube[None])[0], point, atol=RESOLUTION / 2 + 1e-12)
        assert space.to_parameters(space.to_cube(space.defaults)) == pytest.approx(space.defaults)

    @pytest.mark.parametrize(
        ("bounds", "fields", "digits"),
        [
            ((0.0, 100.0), {}, 6),
            ((0.0, 1 / 3), {}, 7),
            ((1e-4, 10.0), {"scale": "log"}, 6),
            ((0.0, 1000.0), {"scale": "symlog"}, 7),
            ((0.0, 1.0), {"step": 0.1}, 1),
        ],
    )
    def test_doubles_have_no_noise_digits(self, bounds, fields, digits):
        """As many significant digits as the resolution takes, and the bounds as they are given."""
        space = SearchSpace([double("x", bounds, bounds[1], **fields)])
        for position in np.linspace(0.0, 1.0, 201)[1:-1]:
            value = space.to_parameters([position])["x"]
            assert value == float(f"{value:.{digits}g}")
            if "step" not in fields:
                assert abs(space.to_cube({"x": value})[0] - position) <= RESOLUTION
        assert [space.to_parameters([z])["x"] for z in (0.0, 1.0)] == list(bounds)

    def test_rounding_keeps_order_and_conditions(self):
        """x and y meet at a value that has more digits than the wider one is rounded to."""
        spaces = [
            SearchSpace([double("x", (0.0, 100.0)), double("y", (0.0, 1.0))], [("x", "y")]),
            SearchSpace(
                [double("x", (0.0, 100.0), 0.0), double("y", (0.0, 1.0), 0.5)], where=["x <= y / 3"]
            ),
        ]
        for space in spaces:
            for point in np.random.default_rng(0).random((100, 2)):
                space.permitted(space.to_parameters(point * [0.01, 1.0]))

    @pytest.mark.parametrize(
        ("parameters", "problem"),
        [
            ({"h_u": 3}, "l_mpc: missing"),
            ({"h_u": 3, "l_mp": 0.0}, "l_mp: unknown parameter; did you mean 'l_mpc'?"),
            ({"h_u": 3.0, "l_mpc": 0.0}, "h_u: expected an integer, found 3.0"),
            ({"h_u": 3, "l_mpc": float("nan")}, "l_mpc: expected a finite number, found nan"),
            ({"h_u": 21, "l_mpc": 0.0}, r"h_u: 21 lies outside the bounds \(1, 20\)"),
        ],
    )
    def test_refuses_what_is_no_parametrization(self, parameters, problem):
        with pytest.raises(ParameterError, match=problem):
            benchmark().to_cube(parameters)

    @pytest.mark.parametrize("cube", [[0.5], [[0.5, 0.5]], [np.nan, 0.5], [np.inf, 0.5]])
    def test_refuses_what_is_no_point(self, cube):
        with pytest.raises(ParameterError, match="expected"):
            benchmark().to_parameters(cube)

    def test_key_tells_parametrizations_apart_that_differ(self):
        space = benchmark()
        key = space.key({"h_u": 3, "l_mpc": -2.0})
        assert key == space.key({"h_u": 3, "h_p": 3, "l_mpc": -2.0 + 1e-9})
        assert key != space.key({"h_u": 4, "l_mpc": -2.0})
        assert key != space.key({"h_u": 3, "l_mpc": -2.0 + 1e-4})
        assert len({key, key}) == 1

    def test_a_symlog_scale_keeps_0_and_spreads_three_decades(self):
        """On it a thousandth of the upper bound is at log 2 / log 1001 of the edge."""
        space = SearchSpace([double("kd", (0.0, 10.0), 0.1, scale="symlog")])
        values = [0.0, 0.01, 0.1, 1.0, 10.0]
        cube = [float(space.to_cube({"kd": v})[0]) for v in values]
        assert cube == pytest.approx(np.log1p(np.array(values) / 0.01) / np.log(1001.0))
        assert space.to_parameters(np.array([0.0])) == {"kd": 0.0}
        back = [space.to_parameters(np.array([z]))["kd"] for z in cube]
        assert back == pytest.approx(values)
        # Half of the edge is below 0.31, which is 3 % of the range.
        assert space.to_parameters(np.array([0.5]))["kd"] == pytest.approx(0.01 * (1001**0.5 - 1))

    def test_integers_on_a_symlog_scale_keep_their_distance(self):
        item = integer("n", (0, 1000), 10, scale="symlog", minimum_correlation=0.1)
        (scale,) = SearchSpace([item]).minimum_length_scales()
        step = np.log(2.0) / np.log(1001.0)
        assert np.exp(-0.5 * (step / scale) ** 2) == pytest.approx(0.1)

    def test_key_tells_decades_of_a_log_scale_apart(self):
        space = SearchSpace([double("w", (1e-8, 1e2), 1e-7, scale="log")])
        values = [1e-8, 1.01e-8, 1e-7, 1.86e-7, 4e-6, 1.0, 99.0]
        assert len({space.key({"w": value}) for value in values}) == len(values)
        assert space.key({"w": 1e-7}) == space.key({"w": 1e-7 * (1.0 + 1e-9)})


class TestRepair:
    def test_nearest_integers(self):
        space = SearchSpace([integer("k", (0, 4))])
        positions = np.array([[-3.0], [0.12], [0.13], [0.6], [0.9], [7.0]])
        np.testing.assert_array_equal(space.repair(positions).ravel() * 4, [0, 0, 1, 2, 4, 4])

    def test_wrong_order_meets_nearest(self):
        """For each pair of horizons, no permitted pair lies nearer than the repaired one."""
        space = full()
        pairs = np.array(list(itertools.product(range(1, 21), range(1, 26))))
        permitted = pairs[pairs[:, 0] <= pairs[:, 1]]
        cube = np.full((len(pairs), 4), 0.5)
        cube[:, :2] = (pairs - 1) / [19, 24]
        repaired = space.repair(cube)[:, :2] * [19, 24] + 1
        distance = np.sum((repaired - pairs) ** 2, axis=1)
        nearest = np.sum((permitted[None] - pairs[:, None]) ** 2, axis=2).min(axis=1)
        np.testing.assert_allclose(distance, nearest, atol=1e-9)

    @each_space
    def test_permitted_twice_the_same_and_row_by_row(self, space):
        positions = np.random.default_rng(0).normal(0.5, 1.0, (200, space.dimension))
        repaired = space.repair(positions)
        assert np.all((repaired >= 0.0) & (repaired <= 1.0))
        assert all(is_permitted(space, space.to_parameters(row)) for row in repaired)
        np.testing.assert_allclose(space.repair(repaired), repaired, atol=1e-12)
        rows = np.vstack([space.repair(row[None]) for row in positions])
        np.testing.assert_array_equal(rows, repaired)

    def test_refuses_other_shapes(self):
        with pytest.raises(ParameterError, match=r"expected shape \(n, 4\), found \(4,\)"):
            full().repair(np.zeros(4))


class TestLatinHypercube:
    def test_one_point_in_each_stratum(self):
        design = SPACES["twelve"].latin_hypercube(30, np.random.default_rng(0))
        strata = np.sort(np.floor(design * 30).astype(int), axis=0)
        np.testing.assert_array_equal(strata, np.tile(np.arange(30)[:, None], (1, 12)))

    def test_every_integer_equally_often(self):
        space = SearchSpace([integer("k", (0, 4)), double("x", (0.0, 1.0))])
        design = space.latin_hypercube(50, np.random.default_rng(0))
        counts = np.bincount(np.rint(design[:, 0] * 4).astype(int))
        np.testing.assert_array_equal(counts, [10] * 5)

    @pytest.mark.parametrize(
        ("item", "values"),
        [
            (integer("k", (0, 10), 0, step=5), [0, 5, 10]),
            (integer("k", (1, 10), 1, step=4), [1, 5, 9]),
            (double("k", (0.0, 1.0), 0.0, step=0.5), [0.0, 0.5, 1.0]),
        ],
    )
    def test_every_value_of_a_grid_equally_often(self, item, values):
        space = SearchSpace([item, double("x", (0.0, 1.0))])
        design = space.latin_hypercube(60, np.random.default_rng(0))
        drawn = [space.to_parameters(point)["k"] for point in design]
        assert [drawn.count(value) for value in values] == [20, 20, 20]

    @each_space
    def test_permitted_and_reproducible(self, space):
        first, second = (space.latin_hypercube(12, np.random.default_rng(5)) for _ in range(2))
        np.testing.assert_array_equal(first, second)
        assert all(is_permitted(space, space.to_parameters(row)) for row in first)

    def test_distinct_as_long_as_the_space_has_enough(self):
        space = SearchSpace([integer("a", (0, 3)), integer("b", (0, 3))], [("a", "b")])
        for count in (5, 10):
            design = space.latin_hypercube(count, np.random.default_rng(count))
            assert len({space.key(space.to_parameters(row)) for row in design}) == count
        design = space.latin_hypercube(14, np.random.default_rng(0))
        assert len({space.key(space.to_parameters(row)) for row in design}) == 10

    def test_order_does_not_pile_points_up(self):
        """Two equal boxes: exchanged pairs are spread over the triangle like uniform ones."""
        space = SearchSpace([double("a", (0, 1)), double("b", (0, 1))], [("a", "b")])
        design = space.latin_hypercube(1000, np.random.default_rng(0))
        # The gap of two ordered uniform numbers exceeds 1/2 with probability 1/4.
        assert np.mean(design[:, 1] - design[:, 0] > 0.5) == pytest.approx(0.25, abs=0.05)
        assert np.mean(design[:, 1] - design[:, 0] < 1e-6) < 0.01

    def test_a_real_parameter_is_spread_on_its_scale(self):
        """One point in each of n strata, which have equal ratios on the log scale."""
        gain = Parameter(
            name="gain", node="pid", type="double", bounds=(0.01, 100.0), default=1.0, scale="log"
        )
        design = SearchSpace([gain]).latin_hypercube(40, np.random.default_rng(0))
        values = np.sort([SearchSpace([gain]).to_parameters(point)["gain"] for point in design])
        assert (np.floor(10 * (np.log10(values) + 2.0)).astype(int) == np.arange(40)).all()

    def test_refuses_an_empty_design(self):
        with pytest.raises(ParameterError, match="at least 1 point, found 0"):
            full().latin_hypercube(0, np.random.default_rng(0))


class TestLengthScalesAndNeighbours:
    def test_kernel_correlates_neighbouring_integers_as_the_study_says(self):
        scales = full().minimum_length_scales()
        steps = np.array([1 / 19, 1 / 24])
        np.testing.assert_allclose(np.exp(-0.5 * (steps / scales[:2]) ** 2), 0.1)
        np.testing.assert_array_equal(scales[2:], 0.0)

    def test_integer_steps_within_bounds_and_order(self):
        space = full()
        at = {"h_u": 1, "h_p": 1, "l_mpc": 0.25, "l_kf": 0.0}
        assert space.integer_neighbours(at) == [at | {"h_p": 2}]
        at |= {"h_u": 4, "h_p": 9}
        assert space.integer_neighbours(at) == [
            at | {"h_u": 3},
            at | {"h_u": 5},
            at | {"h_p": 8},
            at | {"h_p": 10},
        ]

    def test_tied_parameters_step_along(self):
        at = {"h_u": 20, "h_p": 20, "l_mpc": 0.25, "l_kf": -1.0}
        assert benchmark().integer_neighbours(at) == [at | {"h_u": 19, "h_p": 19}]

    def test_doubles_have_none(self):
        space = SPACES["twelve"]
        assert space.integer_neighbours(space.defaults) == []

    def test_of_a_step_on_a_logarithmic_scale(self):
        """Near the lower bound a step is far on that scale, near the upper one it is not."""
        space = SearchSpace([double("k", (1.0, 1001.0), 1.0, step=10.0, scale="log")])
        around = {
            at: [n["k"] for n in space.neighbours({"k": at})] for at in (1.0, 11.0, 21.0, 1001.0)
        }
        assert around[1.0] == [11.0]
        assert around[11.0] == [1.0, 21.0]
        assert around[21.0] == [11.0, 31.0]
        (below,) = around[1001.0]
        assert below < 1001.0

    def test_steps_of_doubles_are_a_part_of_the_range_on_its_scale(self):
        space = SearchSpace([double("a", (-5, 1)), double("b", (1e-3, 1e1), scale="log")])
        at = {"a": 0.123456789, "b": 0.3}
        ratio = 10.0**0.2
        found = space.neighbours(at)
        assert found == [
            {"a": pytest.approx(at["a"] - 0.3), "b": 0.3},
            {"a": pytest.approx(at["a"] + 0.3), "b": 0.3},
            {"a": at["a"], "b": pytest.approx(0.3 / ratio)},
            {"a": at["a"], "b": pytest.approx(0.3 * ratio)},
        ]
        # What stays, stays to the last digit.
        assert [n["a"] == at["a"] for n in found] == [False, False, True, True]
        assert [n["b"] == at["b"] for n in found] == [True, True, False, False]

    def test_no_step_leaves_the_bounds_or_the_order(self):
        space = full()
        at = {"h_u": 1, "h_p": 1, "l_mpc": space.defaults["l_mpc"], "l_kf": 0.0}
        low, high = (dict(zip(space.names, v, strict=True)) for v in (space.lower, space.upper))
        at |= {"l_mpc": float(low["l_mpc"]), "l_kf": float(high["l_kf"])}
        # The first horizon may not grow beyond the second one.
        steps = [{n: p[n] for n in at if p[n] != at[n]} for p in space.neighbours(at)]
        assert [list(step) for step in steps] == [["h_p"], ["l_mpc"], ["l_kf"]]
        assert steps[0] == {"h_p": 2}


class TestStructure:
    @pytest.mark.parametrize(
        ("parameters", "order", "message"),
        [
            ([fixed("a", 1.0)], [], "parameters: no parameter is tuned; give one bounds"),
            (
                [integer("a", (1, 3)), integer("a", (1, 3))],
                [],
                "parameters: two parameters have the same name",
            ),
            (
                [integer("gain", (1, 3)), tied("b", "gian")],
                [],
                "parameters.b.tied_to: there is no other parameter 'gian'; did you mean 'gain'?",
            ),
            (
                [integer("a", (1, 3)), tied("b", "b")],
                [],
                "parameters.b.tied_to: there is no other parameter 'b'; expected one of a",
            ),
            (
                [integer("a", (1, 3)), tied("b", "a"), tied("c", "b")],
                [],
                "parameters.c.tied_to: 'b' is itself tied to 'a'",
            ),
            (
                [integer("x", (1, 3)), tied("a", "b"), tied("b", "a")],
                [],
                "parameters.a.tied_to: 'b' is itself tied to 'a'",
            ),
            (
                [integer("a", (1, 3)), tied("b", "a", "double")],
                [],
                "parameters.b.tied_to: 'a' is of type integer, not double",
            ),
            (
                [integer("a", (1, 3)), tied("b", "a", default=2)],
                [],
                "parameters.b.default: 2 differs from 1, the default of 'a' to which it is tied",
            ),
            (
                [integer("a", (1, 3))],
                [("a", "c")],
                "order[0][1]: there is no parameter 'c'; expected one of a",
            ),
            (
                [integer("a", (1, 3))],
                [("a", "a")],
                "order[0]: 'a' is compared with itself",
            ),
            (
                [integer("a", (1, 3)), double("b", (1, 3))],
                [("a", "b")],
                "order[0]: 'a' and 'b' are of different types",
            ),
            (
                [integer("a", (1, 3)), integer("b", (1, 3)), integer("c", (1, 3))],
                [("a", "b"), ("b", "c"), ("c", "a")],
                "order[2]: 'c' <= 'a' closes a cycle; use tied_to for equal values",
            ),
            (
                [integer("a", (5, 9)), integer("b", (1, 3))],
                [("a", "b")],
                "order[0]: the bounds leave no values with 'a' <= 'b'",
            ),
            (
                [integer("a", (5, 9)), fixed("b", 3, "integer")],
                [("a", "b")],
                "order[0]: the bounds leave no values with 'a' <= 'b'",
            ),
            (
                [integer("a", (1, 9), 4), integer("b", (1, 9), 3)],
                [("a", "b")],
                "order[0]: expected 'a' <= 'b', found the defaults 4 and 3",
            ),
            (
                [integer("k", (1, 9)), fixed("a", 2.0), fixed("b", 1.0)],
                [("a", "b")],
                "order[0]: expected 'a' <= 'b', found the defaults 2.0 and 1.0",
            ),
        ],
    )
    def test_refuses_with_the_reason(self, parameters, order, message):
        with pytest.raises(StudyError) as caught:
            SearchSpace(parameters, order)
        assert str(caught.value) == message

    def test_order_between_tied_parameters_holds_anyway(self):
        space = SearchSpace([integer("a", (1, 3)), tied("b", "a")], [("a", "b"), ("b", "a")])
        assert space.to_parameters([1.0]) == {"a": 3, "b": 3}

    def test_fixed_parameters_bound_others(self):
        space = SearchSpace([integer("a", (1, 9)), fixed("b", 4, "integer")], [("a", "b")])
        assert space.to_parameters([1.0]) == {"a": 4, "b": 4}
        assert space.integer_neighbours({"a": 4}) == [{"a": 3, "b": 4}]
        drawn = [
            space.to_parameters(row)["a"]
            for row in space.latin_hypercube(4, np.random.default_rng(0))
        ]
        assert sorted(drawn) == [1, 2, 3, 4]


class TestPartialOrder:
    order = PartialOrder(5, [(0, 1), (1, 2), (0, 3), (3, 4)])

    @given(values=arrays(float, (3, 5), elements=st.floats(-1e6, 1e6, allow_subnormal=False)))
    @few_examples
    def test_results_are_ordered(self, values):
        assert np.all(self.order.satisfied(self.order.project(values)))
        swapped = self.order.swap(values)
        assert np.all(self.order.satisfied(swapped))
        np.testing.assert_array_equal(np.sort(swapped, axis=1), np.sort(values, axis=1))
        np.testing.assert_array_equal(self.order.project(swapped), swapped)

    def test_implications_reach_along_chains(self):
        assert self.order.implies(0, 2)
        assert self.order.implies(0, 4)
        assert not self.order.implies(1, 3)
        assert not self.order.implies(2, 0)

    def test_tightened_bounds(self):
        low, high = self.order.tighten(
            np.array([2.0, 0.0, 1.0, 0.0, 5.0]), np.array([9.0, 9.0, 4.0, 9.0, 8.0])
        )
        np.testing.assert_array_equal(low, [2, 2, 2, 2, 5])
        np.testing.assert_array_equal(high, [4, 4, 4, 8, 8])
