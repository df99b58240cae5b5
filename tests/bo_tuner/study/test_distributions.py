"""Context distributions against scipy and closed forms, and the space that they span."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from bo_tuner.errors import ParameterError, StudyError
from bo_tuner.study.context_space import ContextSpace
from bo_tuner.study.distributions import (
    DISTRIBUTIONS,
    Beta,
    Discrete,
    Triangular,
    TruncatedNormal,
    Uniform,
)

EXAMPLES = {
    "truncated_normal": TruncatedNormal(mean=1.0, standard_deviation=0.2, bounds=(0.7, 1.3)),
    "uniform": Uniform(bounds=(-2.0, 3.0)),
    "beta": Beta(a=2.0, b=5.0, bounds=(10.0, 20.0)),
    "triangular": Triangular(mode=1.0, bounds=(0.0, 4.0)),
    "discrete": Discrete(values=(1.0, 2.0, 5.0), probabilities=(0.2, 0.5, 0.3)),
}

each_distribution = pytest.mark.parametrize("item", EXAMPLES.values(), ids=EXAMPLES.keys())


def normal_cdf(x, mean, deviation):
    return stats.norm.cdf(x, loc=mean, scale=deviation)


def closed_form_cdf(kind, x):
    if kind == "truncated_normal":
        low, high = normal_cdf(0.7, 1.0, 0.2), normal_cdf(1.3, 1.0, 0.2)
        return (normal_cdf(x, 1.0, 0.2) - low) / (high - low)
    if kind == "uniform":
        return (x + 2.0) / 5.0
    if kind == "beta":
        # Integer shapes: a binomial tail, with z the position between the bounds.
        z = (x - 10.0) / 10.0
        return sum(stats.binom.pmf(k, 6, z) for k in range(2, 7))
    if kind == "triangular":
        return np.where(x <= 1.0, x**2 / 4.0, 1.0 - (4.0 - x) ** 2 / 12.0)
    raise AssertionError(kind)


class TestEveryDistribution:
    @each_distribution
    def test_quantiles_span_the_support_and_never_decrease(self, item):
        quantiles = item.ppf(np.linspace(0.0, 1.0, 101))
        assert quantiles[0] == item.lower
        assert quantiles[-1] == item.upper
        assert np.all(np.diff(quantiles) >= 0.0)

    @each_distribution
    def test_samples_have_the_quantiles_distribution(self, item):
        sample = item.ppf(np.random.default_rng(1).random((200, 5)))
        assert sample.shape == (200, 5)
        assert np.all((sample >= item.lower) & (sample <= item.upper))
        # Dvoretzky, Kiefer and Wolfowitz: at most 0.061 apart with probability 0.999.
        q = np.linspace(0.05, 0.95, 19)
        below = np.mean(sample[..., None] <= item.ppf(q), axis=(0, 1))
        assert np.all(below >= q - 0.061)

    @each_distribution
    @pytest.mark.parametrize("probability", [-0.1, 1.1, np.nan])
    def test_refuses_what_is_no_probability(self, item, probability):
        with pytest.raises(ParameterError, match=r"\[0, 1\]"):
            item.ppf(probability)

    @each_distribution
    def test_clip_returns_the_nearest_of_the_support(self, item):
        np.testing.assert_array_equal(item.clip([-1e3, 1e3]), [item.lower, item.upper])
        assert item.clip(item.nominal) == item.nominal

    @pytest.mark.parametrize("kind", [kind for kind in EXAMPLES if kind != "discrete"])
    def test_quantiles_invert_the_distribution_function(self, kind):
        q = np.linspace(0.01, 0.99, 25)
        np.testing.assert_allclose(closed_form_cdf(kind, EXAMPLES[kind].ppf(q)), q, atol=1e-9)

    @pytest.mark.parametrize("kind", [kind for kind in EXAMPLES if kind != "discrete"])
    @pytest.mark.parametrize(
        ("bounds", "problem"),
        [
            ((1.0, -5.0), "lower bound 1.0 is not below upper bound -5.0"),
            ((2.0, 2.0), "both bounds are 2.0"),
            ((0.0, float("inf")), "expected a finite number, found inf"),
            ((-1e308, 1e308), r"expected 0, or a number between 1e-90 and 1e\+90 in size"),
            ((0, 2**70), "expected a 64-bit integer"),
            ([0.0], r"expected bounds \[lower, upper\], found a list of 1"),
            ("wide", r"expected bounds \[lower, upper\], found text 'wide'"),
        ],
    )
    def test_refuses_bad_bounds(self, kind, bounds, problem):
        fields = {"truncated_normal": {"mean": 0.0, "standard_deviation": 1.0}}.get(kind, {})
        fields |= {"beta": {"a": 1.0, "b": 1.0}, "triangular": {"mode": 0.0}}.get(kind, {})
        with pytest.raises(StudyError, match=problem) as caught:
            DISTRIBUTIONS[kind](bounds=bounds, **fields)
        assert caught.value.path[0] == "bounds"


class TestNominal:
    @pytest.mark.parametrize(
        ("item", "nominal"),
        [
            (TruncatedNormal(mean=1, standard_deviation=0.2, bounds=(0.7, 1.3)), 1.0),
            (TruncatedNormal(mean=9, standard_deviation=0.2, bounds=(0.7, 1.3)), 1.3),
            (Uniform(bounds=(-2, 3)), 0.5),
            (Beta(a=2, b=6, bounds=(10, 20)), 12.5),
            (Triangular(mode=1, bounds=(0, 4)), 1.0),
            (Discrete(values=(1, 2, 5), probabilities=(0.4, 0.2, 0.4)), 1.0),
            (Uniform(bounds=(-2, 3), nominal=3), 3.0),
            (Discrete(values=(1, 2), probabilities=(0.4, 0.6), nominal=1), 1.0),
        ],
    )
    def test_follows_from_the_distribution_unless_given(self, item, nominal):
        assert item.nominal == nominal
        assert isinstance(item.nominal, float)

    def test_must_lie_in_the_support(self):
        with pytest.raises(StudyError, match=r"nominal: 4.0 lies outside the bounds"):
            Uniform(bounds=(-2, 3), nominal=4)
        with pytest.raises(StudyError, match=r"nominal: 1.5 is none of the values"):
            Discrete(values=(1, 2), probabilities=(0.4, 0.6), nominal=1.5)


class TestTruncatedNormal:
    @pytest.mark.parametrize("mean", [-50.0, -1.0, 40.0])
    def test_quantiles_are_usable_far_from_the_mean(self, mean):
        item = TruncatedNormal(mean=mean, standard_deviation=0.5, bounds=(0.0, 1.0))
        quantiles = item.ppf(np.linspace(0.0, 1.0, 11))
        assert np.all(np.isfinite(quantiles))
        assert np.all(np.diff(quantiles) > 0.0)

    def test_refuses_what_cannot_be_computed(self):
        with pytest.raises(StudyError, match="too extreme"):
            TruncatedNormal(mean=1e90, standard_deviation=1e-90, bounds=(1.0, 2.0))

    def test_refuses_a_standard_deviation_of_zero(self):
        with pytest.raises(StudyError, match=r"standard_deviation: expected a number above 0"):
            TruncatedNormal(mean=0.0, standard_deviation=0.0, bounds=(1.0, 2.0))


class TestDiscrete:
    def test_quantile_is_the_smallest_value_that_reaches_the_probability(self):
        quantiles = EXAMPLES["discrete"].ppf([0.0, 0.2, 0.2000001, 0.7, 0.7000001, 1.0])
        np.testing.assert_array_equal(quantiles, [1.0, 1.0, 2.0, 2.0, 5.0, 5.0])

    def test_clip_takes_the_nearest_value(self):
        np.testing.assert_array_equal(
            EXAMPLES["discrete"].clip([1.4, 1.6, 3.4, 3.6]), [1.0, 2.0, 2.0, 5.0]
        )

    @pytest.mark.parametrize(
        ("values", "probabilities", "problem"),
        [
            ([1], [0.5], "values: expected at least two values, found 1"),
            ([1, 1], [0.5, 0.5], "values: expected strictly increasing values"),
            ([2, 1], [0.5, 0.5], "values: expected strictly increasing values"),
            ([1, 2], [1.0], "probabilities: expected one for each of the 2 values, found 1"),
            ([1, 2], [0.5, 0.6], "probabilities: expected a sum of 1, found 1.1"),
            ([1, 2], [0.0, 1.0], r"probabilities\[0\]: expected a number between 0 and 1"),
            ([1, "2"], [0.5, 0.5], "values: expected values of one type"),
            (3, [0.5, 0.5], "values: expected a list of values, found 3"),
        ],
    )
    def test_refuses_bad_tables(self, values, probabilities, problem):
        with pytest.raises(StudyError, match=problem):
            Discrete(values=values, probabilities=probabilities)


class TestContextSpace:
    space = ContextSpace(EXAMPLES)

    def test_keeps_the_order_of_the_names(self):
        assert self.space.names == tuple(EXAMPLES)
        assert self.space.dimension == 5
        np.testing.assert_array_equal(
            self.space.nominal(), [item.nominal for item in EXAMPLES.values()]
        )

    def test_cube_is_linear_between_the_bounds(self):
        middle = self.space.to_contexts([[0.0] * 5, [0.5] * 5, [1.0] * 5])
        np.testing.assert_allclose(
            middle, [[0.7, -2, 10, 0, 1], [1.0, 0.5, 15, 2, 2], [1.3, 3, 20, 4, 5]]
        )

    @given(st.lists(st.floats(-1.0, 2.0), min_size=5, max_size=5))
    @settings(max_examples=50)
    def test_round_trip_through_the_cube(self, point):
        contexts = self.space.to_contexts([point])
        again = self.space.to_contexts(self.space.to_cube(contexts))
        np.testing.assert_allclose(again, contexts, rtol=0, atol=1e-12)

    def test_fewer_draws_are_the_first_of_more(self):
        few = self.space.draw(5, np.random.default_rng(3))
        many = self.space.draw(25, np.random.default_rng(3))
        np.testing.assert_array_equal(few, many[:5])

    def test_draws_are_independent_of_one_another(self):
        contexts = self.space.draw(4000, np.random.default_rng(4))
        correlation = np.corrcoef(contexts, rowvar=False) - np.eye(5)
        # Four standard deviations of an estimated correlation.
        assert np.all(np.abs(correlation) < 4.0 / np.sqrt(4000))

    def test_clip_moves_to_possible_contexts(self):
        np.testing.assert_array_equal(
            self.space.clip([[0.0, 9.0, 15.0, -1.0, 1.9]]), [[0.7, 3.0, 15.0, 0.0, 2.0]]
        )

    def test_names_the_values_of_a_context(self):
        assert self.space.to_dict(self.space.nominal())["beta"] == EXAMPLES["beta"].nominal

    def test_nothing_to_perturb(self):
        space = ContextSpace({})
        assert space.draw(3, np.random.default_rng(0)).shape == (3, 0)
        assert space.to_contexts(np.empty((2, 0))).shape == (2, 0)
        assert space.to_cube(np.empty((2, 0))).shape == (2, 0)
        assert space.to_dict(space.nominal()) == {}

    @pytest.mark.parametrize("wrong", [[0.5] * 5, [[0.5] * 4], [[np.nan] * 5]])
    def test_refuses_other_shapes_and_what_is_not_finite(self, wrong):
        with pytest.raises(ParameterError, match="cube: expected"):
            self.space.to_contexts(wrong)
