"""The acquisition function against sampling, the plain product and its extremes."""

import numpy as np
import pytest
from scipy.stats import norm

from bo_tuner.acquisition.acquisition import Acquisition, best_at_data, constrained_improvement
from bo_tuner.models.gaussian_process import GaussianProcess
from bo_tuner.models.hyperpriors import Hyperparameters
from bo_tuner.models.nearest_neighbours import NeighbourClassifier
from bo_tuner.models.surrogates import Surrogates
from tuning_benchmark.paper.constraints import SurrogateConstraint

THETA = Hyperparameters(np.array([0.3, 0.5]), 1.0, 0.3)


def model(seed=0, scale=1.0, points=12):
    rng = np.random.default_rng(seed)
    x = np.repeat(rng.random((points, 2)), 5, axis=0)
    y = scale * (np.sin(4.0 * x[:, 0]) + x[:, 1] + 0.3 * rng.normal(size=len(x)))
    return GaussianProcess.condition(THETA, x, y)


def make_acquisition(objective, best, constraints=(), *, failures=None, outlying=None, **options):
    named = {str(k): constraint for k, constraint in enumerate(constraints)}
    surrogates = Surrogates(objective, named, failures, outlying)
    options = {"avoid": 0.5, "reinterpolate": True} | options
    return constrained_improvement(surrogates, best, **options)


def queries(count=50):
    return np.random.default_rng(9).random((count, 2))


def test_expectation_constraint_is_the_probability_of_the_latent_response():
    surrogate = model()
    mean, variance = surrogate.predict(queries())
    constraint = SurrogateConstraint(surrogate, 0.8)
    expected = norm.logcdf(0.8, mean, np.sqrt(variance))
    np.testing.assert_allclose(constraint.log_probability(queries()), expected, rtol=1e-9)


def test_observation_constraint_equals_sampling():
    """P over f of [P over noise of [y ≤ limit] ≥ p], both by draws or by the normal quantile."""
    surrogate, limit, probability = model(), 1.5, 0.96
    mean, variance = surrogate.predict(queries(5))
    latent = mean + np.sqrt(variance) * np.random.default_rng(0).normal(size=(200_000, 5))
    holds = norm.cdf((limit - latent) / np.sqrt(surrogate.noise_variance)) >= probability
    constraint = SurrogateConstraint.on_observation(surrogate, limit, probability)
    own = np.exp(constraint.log_probability(queries(5)))
    np.testing.assert_allclose(own, holds.mean(axis=0), atol=5e-3)


def test_half_probability_leaves_the_limit():
    surrogate = model()
    assert SurrogateConstraint.on_observation(surrogate, 0.8, 0.5).limit == pytest.approx(0.8)


@pytest.mark.parametrize("probability", [0.0, 1.0, -0.1, np.nan])
def test_bad_probability_is_refused(probability):
    with pytest.raises(ValueError, match=r"probability: expected a value in \(0, 1\), found"):
        SurrogateConstraint.on_observation(model(), 0.8, probability)


def test_sum_of_logarithms_equals_the_product_of_equation_five():
    objective, overshoot, times = model(0), model(1), model(2)
    x = queries()
    labels = x[:20, 0] > 0.7
    crashes = NeighbourClassifier(queries(20), labels, THETA.length_scales)
    outliers = NeighbourClassifier(queries(20), ~labels, THETA.length_scales)
    query = np.random.default_rng(11).random((40, 2))
    mean, variance = objective.predict_reinterpolated(query)
    sd, best = np.sqrt(variance), 0.2
    z = (best - mean) / sd
    expected = (best - mean) * norm.cdf(z) + sd * norm.pdf(z)
    worst_mean, worst_variance = overshoot.predict(query)
    expected *= norm.cdf(1.0, worst_mean, np.sqrt(worst_variance))
    time_mean, time_variance = times.predict(query)
    margin = norm.ppf(0.96) * np.sqrt(times.noise_variance)
    expected *= norm.cdf(1.8 - margin, time_mean, np.sqrt(time_variance))
    expected *= (1.0 - crashes.probability(query)) * (1.0 - outliers.probability(query))
    acquisition = make_acquisition(
        objective,
        best,
        (
            SurrogateConstraint(overshoot, 1.0),
            SurrogateConstraint.on_observation(times, 1.8, 0.96),
        ),
        failures=crashes,
        outlying=outliers,
        avoid=1.0,
    )
    np.testing.assert_allclose(np.exp(acquisition(query)), expected, rtol=1e-7, atol=1e-250)


@pytest.mark.parametrize("best", [None, 0.2])
def test_what_cannot_exceed_a_value_is_left_out(best):
    """Each term lowers the sum, so the first ones can tell."""
    asked = []

    class Counted(SurrogateConstraint):
        def log_probability(self, x):
            asked.append(len(x))
            return super().log_probability(x)

    acquisition = make_acquisition(
        model(), best, (SurrogateConstraint(model(1), 1.0), Counted(model(2), 1.8))
    )
    x = queries()
    whole = acquisition(x)
    assert asked == [len(x)]
    least = np.full(len(x), np.median(whole))
    found = acquisition.where_above(least, x)
    above = whole > least
    np.testing.assert_allclose(found[above], whole[above], rtol=1e-12)
    assert above.any()
    assert (found[~above] == -np.inf).all()
    assert asked[1] >= above.sum()
    assert (acquisition.where_above(np.full(len(x), whole.max() + 1e9), x) == -np.inf).all()
    assert len(asked) == 2


@pytest.mark.parametrize("improvement", [np.nan, -np.inf, 2.0])
def test_only_a_number_above_the_value_counts(improvement):
    known = np.full(3, improvement)
    product = Acquisition(lambda x: known, (lambda x: np.where(x[:, 0] > 0.5, -np.inf, -1.0),))
    x, least = np.array([[0.0], [0.2], [0.9]]), np.array([-np.inf, 5.0, -np.inf])
    found = product.where_above(least, x)
    sound = improvement - 1.0 if improvement > 0.0 else -np.inf
    assert found.tolist() == [sound, -np.inf, -np.inf]
    # What a factor returns is its own.
    np.testing.assert_array_equal(known, np.full(3, improvement))


@pytest.mark.parametrize("best", [None, -1.0, 0.2, 1e6])
def test_evaluated_points_are_excluded_exactly_and_no_others(best):
    objective = model()
    acquisition = make_acquisition(objective, best)
    assert (acquisition(objective.points) == -np.inf).all()
    assert np.isfinite(acquisition(queries())).all()


def test_crashed_points_are_excluded():
    x = queries(6)
    crashes = NeighbourClassifier(x, np.ones(6, dtype=bool), THETA.length_scales)
    for objective in (None, model()):
        acquisition = make_acquisition(objective, None, failures=crashes, avoid=1.0)
        assert (acquisition(x) == -np.inf).all()
        assert np.isfinite(acquisition(np.random.default_rng(3).random((20, 2)))).all()


@pytest.mark.parametrize("avoid", [0.3, 0.5, 0.9])
def test_points_near_crashes_are_left_out(avoid):
    x = queries()
    crashes = NeighbourClassifier(x, x[:, 0] > 0.6, THETA.length_scales)
    query = np.random.default_rng(5).random((200, 2))
    excluded = make_acquisition(None, None, failures=crashes, avoid=avoid)(query) == -np.inf
    assert 0 < excluded.sum() < 200
    np.testing.assert_array_equal(excluded, crashes.probability(query) > avoid)


@pytest.mark.parametrize("avoid", [0.1, 0.5, 0.9])
def test_an_outlier_closes_where_it_is_more_likely_than_not(avoid):
    """However many failures are allowed: it must neither close nor open more than that."""
    x = queries()
    outliers = NeighbourClassifier(x, x[:, 0] > 0.6, THETA.length_scales)
    query = np.random.default_rng(5).random((200, 2))
    excluded = make_acquisition(None, None, outlying=outliers, avoid=avoid)(query) == -np.inf
    np.testing.assert_array_equal(excluded, outliers.probability(query) > 0.5)


def test_without_a_feasible_point_feasibility_is_sought():
    overshoot = model(1)
    constraint = SurrogateConstraint(overshoot, -3.0)
    acquisition = make_acquisition(model(0), None, (constraint,))
    np.testing.assert_array_equal(acquisition(queries()), constraint.log_probability(queries()))


@pytest.mark.parametrize("scale", [1e-60, 1e-9, 1.0, 1e60])
@pytest.mark.parametrize("limit", [-1e90, 0.0, 1e90])
def test_values_stay_finite_for_any_scale_and_limit(scale, limit):
    surrogate = model(scale=scale)
    acquisition = make_acquisition(
        surrogate, limit, (SurrogateConstraint.on_observation(surrogate, limit, 0.999),)
    )
    assert np.isfinite(acquisition(queries())).all()


def test_the_best_is_the_lowest_posterior_mean_of_the_feasible_points():
    surrogate = model()
    mean, _ = surrogate.predict(surrogate.points)
    feasible = np.zeros(len(mean), dtype=bool)
    assert best_at_data(surrogate, feasible) is None
    feasible[[2, 5]] = True
    assert best_at_data(surrogate, feasible) == pytest.approx(min(mean[2], mean[5]))
