"""The Gaussian process against scikit-learn, the naive model of all points, and bad data."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import approx_fprime
from scipy.stats import norm
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF, ConstantKernel, WhiteKernel

from bo_tuner.models import gaussian_process, log_posterior
from bo_tuner.models.gaussian_process import GaussianProcess
from bo_tuner.models.hyperpriors import Hyperparameters, Hyperpriors, LogNormal
from bo_tuner.models.kernel import MEAN_SD, jittered_cholesky
from bo_tuner.models.log_posterior import LogPosterior
from bo_tuner.models.replicates import Replicates, Standardization

THETA = Hyperparameters(np.array([0.3, 0.8, 2.0]), 1.4, 0.2)


def smooth(x):
    return np.sin(5.0 * x[:, 0]) + 2.0 * x[:, -1] ** 2


def observations(seed=0, points=15, replicates=1, dimension=3, noise=0.1):
    rng = np.random.default_rng(seed)
    x = np.repeat(rng.random((points, dimension)), replicates, axis=0)
    return x, smooth(x) + noise * rng.normal(size=len(x))


def reference(theta, x, z):
    """Return scikit-learn's process of all N points, its mean integrated out by a constant."""
    kernel = (
        ConstantKernel(theta.signal**2) * RBF(theta.length_scales)
        + ConstantKernel(MEAN_SD**2, constant_value_bounds="fixed")
        + WhiteKernel(theta.noise**2)
    )
    # alpha: without scikit-learn's own jitter
    return GaussianProcessRegressor(kernel, alpha=0.0, optimizer=None).fit(x, z)


def standardized(x, y):
    z = Standardization.of(y).apply(y)
    return z, LogPosterior(Replicates.group(x, z), Hyperpriors.default(x.shape[1]))


@pytest.mark.parametrize("replicates", [1, 5])
def test_likelihood_and_gradient_equal_scikit_learn(replicates):
    x, y = observations(replicates=replicates)
    z, posterior = standardized(x, y)
    sklearn = reference(THETA, x, z)
    value, gradient = sklearn.log_marginal_likelihood(sklearn.kernel_.theta, eval_gradient=True)
    own_value, own_gradient = posterior.log_marginal_likelihood(THETA.to_log())
    assert own_value == pytest.approx(value, rel=1e-10)
    # scikit-learn: log signal variance, log length scales, log noise variance
    expected = np.concatenate([gradient[1:4], 2.0 * gradient[:1], 2.0 * gradient[4:]])
    np.testing.assert_allclose(own_gradient, expected, rtol=1e-8, atol=1e-8)


@pytest.mark.parametrize("replicates", [1, 5])
def test_posterior_equals_scikit_learn(replicates):
    x, y = observations(replicates=replicates)
    z, _ = standardized(x, y)
    query = np.random.default_rng(1).random((40, 3))
    mean, sd = reference(THETA, x, z).predict(query, return_std=True)
    model = GaussianProcess.condition(THETA, x, y)
    own_mean, own_variance = model.predict(query)
    np.testing.assert_allclose(own_mean, y.mean() + y.std() * mean, rtol=1e-9)
    # scikit-learn's white kernel adds the noise to the prediction, ours is of the latent response
    np.testing.assert_allclose(own_variance + model.noise_variance, (y.std() * sd) ** 2, rtol=1e-9)


def test_unequal_replicates_equal_the_dense_normal_density():
    x, y = observations(points=6, dimension=2)
    rows = np.array([0, 0, 0, 1, 2, 2, 3, 4, 5, 5, 5, 5])
    x, y = x[rows], y[rows] + np.random.default_rng(2).normal(size=len(rows))
    theta = Hyperparameters(np.array([0.4, 0.7]), 0.9, 0.3)
    z, posterior = standardized(x, y)
    squared = (((x[:, None] - x[None]) / theta.length_scales) ** 2).sum(axis=2)
    dense = theta.signal**2 * np.exp(-0.5 * squared) + MEAN_SD**2 + theta.noise**2 * np.eye(len(x))
    expected = (
        -0.5 * z @ np.linalg.solve(dense, z)
        - 0.5 * np.linalg.slogdet(dense)[1]
        - 0.5 * len(z) * np.log(2.0 * np.pi)
    )
    own, _ = posterior.log_marginal_likelihood(theta.to_log())
    assert own == pytest.approx(expected, rel=1e-11)


@pytest.mark.parametrize("replicates", [1, 4])
def test_posterior_gradient_equals_finite_differences(replicates):
    x, y = observations(replicates=replicates)
    _, posterior = standardized(x, y)
    for phi in (THETA.to_log(), np.log([0.05, 0.5, 5.0, 0.3, 1.0])):
        numeric = approx_fprime(phi, posterior.value, 1e-6)
        value, gradient = posterior.value_and_gradient(phi)
        assert value == pytest.approx(posterior.value(phi), rel=1e-13)
        np.testing.assert_allclose(gradient, numeric, rtol=1e-4, atol=1e-3)


def test_log_prior_equals_the_normal_density_of_the_logarithm():
    priors = Hyperpriors.default(3)
    phi = THETA.to_log()
    expected = (
        norm.logpdf(phi[:3], np.log(0.5 * np.sqrt(3.0)), 1.0).sum()
        + norm.logpdf(phi[3], 0.0, 1.0)
        + norm.logpdf(phi[4], np.log(0.1), 1.5)
    )
    value, gradient = priors.log_density(phi)
    assert value == pytest.approx(expected, rel=1e-12)
    numeric = approx_fprime(phi, lambda p: priors.log_density(p)[0], 1e-7)
    np.testing.assert_allclose(gradient, numeric, atol=1e-5)


def test_fit_reaches_a_stationary_point_as_good_as_a_tight_multistart():
    x, y = observations(points=25, replicates=3)
    model = GaussianProcess.fit(x, y, rng=np.random.default_rng(0))
    _, posterior = standardized(x, y)
    phi = model.hyperparameters.to_log()
    box = Hyperpriors.default(3).bounds(3)
    gradient = posterior.value_and_gradient(phi)[1]
    inside = (phi > box[:, 0] + 1e-9) & (phi < box[:, 1] - 1e-9)
    assert np.abs(gradient[inside]).max() < 0.1
    rng = np.random.default_rng(3)
    best = -np.inf
    for _ in range(5):
        start = np.clip(posterior.priors.draw(3, rng), *box.T)
        result = log_posterior.minimize(
            lambda p: -posterior.value(p), start, method="L-BFGS-B", bounds=box
        )
        best = max(best, -result.fun)
    assert posterior.value(phi) > best - 1e-2


def test_fit_recovers_noise_and_relevance():
    x, y = observations(points=40, replicates=5, dimension=3, noise=0.2)
    model = GaussianProcess.fit(x, y, rng=np.random.default_rng(0))
    assert model.noise_variance == pytest.approx(0.04, rel=0.3)
    relevant, irrelevant, _ = model.hyperparameters.length_scales
    assert irrelevant > 3.0 * relevant
    query = np.random.default_rng(1).random((200, 3))
    error = model.predict(query)[0] - smooth(query)
    assert np.sqrt((error**2).mean()) < 0.15
    assert model.warnings == ()


def test_minimum_length_scales_hold():
    x, y = observations(points=20, dimension=2)
    y = y + np.sin(60.0 * x[:, 0])
    minimum = [0.6, 0.0]
    model = GaussianProcess.fit(x, y, rng=np.random.default_rng(0), minimum_length_scales=minimum)
    assert (model.hyperparameters.length_scales >= np.array(minimum) * (1.0 - 1e-12)).all()
    far = GaussianProcess.fit(
        x, y, rng=np.random.default_rng(0), minimum_length_scales=[50.0, 50.0]
    )
    np.testing.assert_allclose(far.hyperparameters.length_scales, 50.0)


def test_warm_start_reaches_the_optimum_of_the_cold_one():
    x, y = observations(points=30, replicates=2)
    cold = GaussianProcess.fit(x, y, rng=np.random.default_rng(0))
    earlier = GaussianProcess.fit(x[:-2], y[:-2], rng=np.random.default_rng(0))
    warm = GaussianProcess.fit(x, y, rng=np.random.default_rng(0), start=earlier.warm_start)
    _, posterior = standardized(x, y)
    assert posterior.value(warm.hyperparameters.to_log()) == pytest.approx(
        posterior.value(cold.hyperparameters.to_log()), abs=1e-2
    )


def test_outgrown_warm_start_is_left():
    """The earlier fit explains all as noise, a local optimum from which no gradient leads away."""
    x = np.linspace(0.0, 1.0, 40)[:, None]
    y = np.sin(25.0 * x[:, 0])
    stale = Hyperparameters(np.array([20.0]), 0.05, 1.0)
    _, posterior = standardized(x, y)
    priors, box = posterior.priors, Hyperpriors.default(1).bounds(1)
    only_stale = log_posterior.minimize(
        lambda p: -posterior.value(p), stale.to_log(), method="L-BFGS-B", bounds=box
    )
    model = GaussianProcess.fit(
        x, y, rng=np.random.default_rng(0), priors=priors, start=stale.to_log()
    )
    assert posterior.value(model.hyperparameters.to_log()) > 10.0 - only_stale.fun


@settings(max_examples=10)
@given(st.integers(0, 1000))
def test_the_order_of_the_data_does_not_matter(seed):
    x, y = observations(seed, points=8, replicates=3, dimension=2)
    order = np.random.default_rng(seed).permutation(len(y))
    query = np.random.default_rng(1).random((5, 2))
    one = GaussianProcess.fit(x, y, rng=np.random.default_rng(0))
    other = GaussianProcess.fit(x[order], y[order], rng=np.random.default_rng(0))
    np.testing.assert_array_equal(one.predict(query), other.predict(query))


class TestReinterpolation:
    def test_variance_is_exactly_zero_at_the_data_and_the_mean_is_kept(self):
        x, y = observations(points=40, replicates=5, noise=0.3)
        model = GaussianProcess.fit(x, y, rng=np.random.default_rng(0))
        mean, variance = model.predict_reinterpolated(x)
        assert (variance == 0.0).all()
        np.testing.assert_array_equal(mean, model.predict(x)[0])

    def test_equals_an_interpolating_model_through_the_posterior_means(self):
        x, y = observations(points=12)
        model = GaussianProcess.condition(THETA, x, y)
        through = model.standardization.apply(model.predict(x)[0])
        noise_free = Hyperparameters(THETA.length_scales, THETA.signal, 1e-6)
        query = np.random.default_rng(1).random((30, 3))
        mean, sd = reference(noise_free, x, through).predict(query, return_std=True)
        own_mean, own_variance = model.predict_reinterpolated(query)
        np.testing.assert_allclose(own_mean, y.mean() + y.std() * mean, rtol=1e-5)
        np.testing.assert_allclose(own_variance, (y.std() * sd) ** 2, rtol=1e-4, atol=1e-8)

    def test_variance_is_positive_between_the_data_and_below_the_noisy_one(self):
        x, y = observations(points=20, replicates=3, noise=0.3)
        model = GaussianProcess.fit(x, y, rng=np.random.default_rng(0))
        query = np.random.default_rng(1).random((50, 3))
        variance = model.predict_reinterpolated(query)[1]
        assert (variance > 0.0).all()
        assert (variance <= model.predict(query)[1] * (1.0 + 1e-6)).all()

    @pytest.mark.parametrize("resolution", [1e-9, 1e-15])
    def test_zero_at_the_data_does_not_hang_on_rounding(self, monkeypatch, resolution):
        monkeypatch.setattr(gaussian_process, "INTERPOLATION_RESOLUTION", resolution)
        x, y = observations(points=60, dimension=2)
        theta = Hyperparameters(np.array([2.0, 2.0]), 20.0, 0.1)
        model = GaussianProcess.condition(theta, x, y)
        assert (model.predict_reinterpolated(x)[1] == 0.0).all()

    def test_crowded_data(self):
        grid = np.linspace(0.0, 1.0, 60)[:, None]
        model = GaussianProcess.condition(
            Hyperparameters(np.array([5.0]), 1.0, 0.1), grid, smooth(grid)
        )
        mean, variance = model.predict_reinterpolated(np.linspace(0.0, 1.0, 333)[:, None])
        assert np.isfinite(mean).all()
        assert (variance >= 0.0).all()
        assert (model.predict_reinterpolated(grid)[1] == 0.0).all()


class TestHardData:
    def fit(self, x, y):
        model = GaussianProcess.fit(x, y, rng=np.random.default_rng(0))
        mean, variance = model.predict(np.random.default_rng(1).random((20, np.shape(x)[1])))
        assert np.isfinite(mean).all()
        assert (variance >= 0.0).all()
        assert np.isfinite(variance).all()
        return model, mean

    def test_constant_responses(self):
        x, _ = observations()
        _, mean = self.fit(x, np.full(len(x), 5e-4))
        np.testing.assert_allclose(mean, 5e-4, rtol=1e-12)

    def test_one_observation(self):
        _, mean = self.fit([[0.5, 0.5]], [3.0])
        np.testing.assert_allclose(mean, 3.0)

    def test_one_point_with_replicates(self):
        model, _ = self.fit(np.full((5, 2), 0.5), np.arange(5.0))
        assert model.predict([[0.5, 0.5]])[0][0] == pytest.approx(2.0)

    def test_zero_noise_interpolates(self):
        x, y = observations(points=30, dimension=2, noise=0.0)
        model, _ = self.fit(np.repeat(x, 5, axis=0), np.repeat(y, 5))
        np.testing.assert_allclose(model.predict(x)[0], y, atol=1e-4)

    def test_twelve_dimensions(self):
        x, y = observations(points=30, dimension=12)
        self.fit(x, y)

    def test_nearly_coincident_points(self):
        x, y = observations(points=20, dimension=2, noise=0.0)
        self.fit(np.concatenate([x, np.clip(x + 1e-12, 0.0, 1.0)]), np.concatenate([y, y]))

    def test_huge_and_tiny_responses(self):
        x, y = observations()
        for factor in (1e-90, 1e90):
            _, mean = self.fit(x, factor * y)
            np.testing.assert_allclose(mean / factor, self.fit(x, y)[1], rtol=1e-6)

    def test_new_data_with_given_hyperparameters_and_standardization(self):
        x, y = observations()
        model = GaussianProcess.fit(x, y, rng=np.random.default_rng(0))
        again = GaussianProcess.condition(
            model.hyperparameters, x[:5], y[:5], model.standardization
        )
        assert again.standardization == model.standardization
        assert again.noise_variance == model.noise_variance
        assert (again.predict(x)[1] >= model.predict(x)[1] - 1e-12).all()


class TestNumericalTrouble:
    def test_jitter_ladder_factors_a_singular_matrix(self):
        singular = np.ones((50, 50))
        factor, jitter = jittered_cholesky(singular)
        assert 0.0 < jitter <= 1e-8
        np.testing.assert_allclose(factor @ factor.T, singular + jitter * np.eye(50), atol=1e-12)

    def test_jitter_ladder_ends_even_for_an_indefinite_matrix(self):
        indefinite = np.eye(4) - 0.9 * (np.ones((4, 4)) - np.eye(4))
        assert np.linalg.eigvalsh(indefinite)[0] < -1.0
        factor, _ = jittered_cholesky(indefinite)
        assert np.isfinite(factor).all()

    def test_nothing_is_added_to_a_good_matrix(self):
        factor, jitter = jittered_cholesky(np.diag([4.0, 9.0]))
        assert jitter == 0.0
        np.testing.assert_array_equal(factor, np.diag([2.0, 3.0]))

    def test_needed_jitter_is_reported(self):
        theta = Hyperparameters(np.array([20.0]), 20.0, 1e-9)
        grid = np.linspace(0.0, 1.0, 100)[:, None]
        model = GaussianProcess.condition(theta, grid, smooth(grid))
        assert model.warnings
        assert "covariance matrix: needed" in model.warnings[0]
        assert np.isfinite(model.predict(grid)[0]).all()

    @pytest.mark.parametrize("start", [None, tuple(THETA.to_log())])
    def test_a_failed_fit_keeps_the_earlier_hyperparameters_or_the_medians(
        self, monkeypatch, start
    ):
        def broken(self, phi):
            return np.nan, np.full_like(phi, np.nan)

        monkeypatch.setattr(log_posterior.LogPosterior, "value_and_gradient", broken)
        x, y = observations()
        model = GaussianProcess.fit(x, y, rng=np.random.default_rng(0), start=start)
        expected = Hyperpriors.default(3).medians(3) if start is None else start
        np.testing.assert_allclose(model.hyperparameters.to_log(), expected, rtol=1e-12)
        assert "hyperparameters: the log posterior is not finite" in model.warnings[0]
        assert np.isfinite(model.predict(x)[0]).all()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"minimum_length_scales": [0.1]}, r"minimum_length_scales: expected shape \(3,\)"),
        ({"minimum_length_scales": [0.1, np.nan, 0]}, "minimum_length_scales: expected finite"),
        ({"minimum_length_scales": [0.1, -1.0, 0]}, "minimum_length_scales: expected finite"),
        (
            {"start": np.zeros(4)},
            "start: expected 5 values, found 4",
        ),
    ],
)
def test_bad_options_are_refused(options, message):
    x, y = observations()
    with pytest.raises(ValueError, match=message):
        GaussianProcess.fit(x, y, rng=np.random.default_rng(0), **options)


def test_queries_of_another_dimension_are_refused():
    x, y = observations()
    model = GaussianProcess.condition(THETA, x, y)
    for predict in (model.predict, model.predict_reinterpolated):
        with pytest.raises(ValueError, match=r"x: expected shape \(m, 3\), found \(4, 2\)"):
            predict(np.zeros((4, 2)))
    with pytest.raises(ValueError, match="hyperparameters: expected 2 length scales"):
        GaussianProcess.condition(THETA, x[:, :2], y)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((1.0, 1.0, 2.0, 3.0), "lower 2, median 1, upper 3"),
        ((1.0, 1.0, 0.0, 3.0), "lower 0"),
        ((1.0, 0.0, 0.5, 3.0), "expected spread > 0, found 0"),
        ((np.nan, 1.0, 0.5, 3.0), "median nan"),
    ],
)
def test_bad_priors_are_refused(arguments, message):
    with pytest.raises(ValueError, match=message):
        LogNormal(*arguments)


def test_many_dimensions_have_a_prior_within_its_bounds():
    """From 1600 on, the median 0.5 √d is beyond the upper bound."""
    assert Hyperpriors.default(1600).length_scale.median == pytest.approx(20.0)
    assert Hyperpriors.default(1700).length_scale.median == 20.0
