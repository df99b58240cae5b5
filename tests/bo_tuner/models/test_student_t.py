"""The Student-t process: its mode, and planted outliers."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import minimize
from scipy.stats import t

from bo_tuner.models.gaussian_process import GaussianProcess
from bo_tuner.models.hyperpriors import Hyperparameters
from bo_tuner.models.kernel import latent_covariance
from bo_tuner.models.replicates import Standardization
from bo_tuner.models.student_t import DEGREES_OF_FREEDOM, StudentTProcess, find_outliers

UNIT = Standardization(0.0, 1.0)


def smooth(x):
    return 0.15 + 0.05 * np.sin(5.0 * x[:, 0]) + 0.1 * x[:, 1] ** 2


def reference_process(theta):
    """Return a reference whose standardization leaves responses unchanged."""
    return GaussianProcess.condition(
        theta, np.full((1, len(theta.length_scales)), 0.5), [0.0], UNIT
    )


def test_the_mode_is_a_maximum_of_the_joint_density():
    rng = np.random.default_rng(4)
    x = rng.random((8, 1))
    y = np.sin(5.0 * x[:, 0])
    y[3] += 6.0
    theta = Hyperparameters(np.array([0.4]), 1.0, 0.2)
    process = StudentTProcess.fit(x, y, reference_process(theta))
    points, observed = process.data.x, process.data.mean
    factor = np.linalg.cholesky(latent_covariance(theta, points, points) + 1e-10 * np.eye(8))

    def loss(whitened):
        residual = observed - factor @ whitened
        likelihood = t.logpdf(residual, DEGREES_OF_FREEDOM, scale=process.scale).sum()
        return 0.5 * whitened @ whitened - likelihood

    start = np.linalg.solve(factor, process.mode)
    polished = minimize(loss, start, method="BFGS", options={"gtol": 1e-6})
    assert loss(start) - polished.fun < 1e-3
    np.testing.assert_allclose(factor @ polished.x, process.mode, atol=0.02)


def test_a_step_beyond_the_mode_cannot_diverge():
    """Ten contradictory observations with a tiny scale: many modes, strongly not concave."""
    x = np.linspace(0.0, 1.0, 10)[:, None]
    y = np.tile([-30.0, 30.0], 5)
    theta = Hyperparameters(np.array([1.0]), 1.0, 1e-3)
    process = StudentTProcess.fit(x, y, reference_process(theta))
    assert np.isfinite(process.mode).all()
    assert (np.abs(process.mode) <= 30.0).all()


def planted(seed, points=40, replicates=5):
    """Return a smooth response, huge values in a corner region and at three more points."""
    rng = np.random.default_rng(seed)
    distinct = rng.random((points, 2))
    clean = smooth(distinct)
    bad = (distinct[:, 0] < 0.25) & (distinct[:, 1] > 0.6)
    bad[rng.choice(points, 3, replace=False)] = True
    response = np.where(bad, rng.uniform(1.0, 40.0, points), clean)
    x = np.repeat(distinct, replicates, axis=0)
    y = np.repeat(response, replicates) * (1.0 + 0.05 * rng.normal(size=len(x)))
    return x, y, np.repeat(bad, replicates)


@pytest.mark.parametrize("seed", range(5))
def test_planted_outliers_are_found_and_the_model_of_the_rest_is_saved(seed):
    x, y, bad = planted(seed)
    rng = np.random.default_rng(0)
    outliers, _ = find_outliers(x, y, rng=rng)
    model = GaussianProcess.fit(x[~outliers], y[~outliers], rng=rng)
    assert (outliers[bad]).all()
    assert outliers[~bad].mean() <= 0.05
    plain = GaussianProcess.fit(x, y, rng=rng)
    query = rng.random((400, 2))
    query = query[(query[:, 0] > 0.3) | (query[:, 1] < 0.55)]

    def rms(surrogate):
        return np.sqrt(((surrogate.predict(query)[0] - smooth(query)) ** 2).mean())

    assert rms(model) < 0.02
    assert rms(model) < 0.1 * rms(plain)


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("points", [10, 60])
def test_clean_data_have_hardly_an_outlier(seed, points):
    rng = np.random.default_rng(seed)
    x = np.repeat(rng.random((points, 2)), 5, axis=0)
    y = smooth(x) + 0.02 * rng.normal(size=len(x))
    outliers, _ = find_outliers(x, y, rng=rng)
    assert outliers.mean() <= 0.04


def test_a_steep_but_smooth_response_is_no_outlier():
    rng = np.random.default_rng(0)
    x = np.repeat(rng.random((40, 2)), 5, axis=0)
    y = np.exp(3.0 * x[:, 0]) + 0.05 * rng.normal(size=len(x))
    assert not find_outliers(x, y, rng=rng)[0].any()


def test_variation_above_a_plateau_is_no_outlier():
    rng = np.random.default_rng(0)
    x = np.repeat(rng.random((40, 2)), 5, axis=0)
    y = np.maximum(1e-3, 0.6 * (x[:, 0] - 0.6))
    assert (y == 1e-3).mean() > 0.5
    assert not find_outliers(x, y, rng=rng)[0].any()


def test_values_below_the_model_are_no_outliers():
    rng = np.random.default_rng(0)
    x = np.repeat(rng.random((30, 2)), 5, axis=0)
    y = smooth(x) + 0.01 * rng.normal(size=len(x))
    y[:5] -= 3.0
    assert not find_outliers(x, y, rng=rng)[0][:5].any()


def test_replicates_share_their_fate_and_the_order_does_not_matter():
    x, y, _ = planted(2)
    order = np.random.default_rng(1).permutation(len(y))
    outliers = find_outliers(x, y, rng=np.random.default_rng(0))[0]
    shuffled = find_outliers(x[order], y[order], rng=np.random.default_rng(0))[0]
    assert (outliers.reshape(-1, 5) == outliers[::5, None]).all()
    np.testing.assert_array_equal(outliers[order], shuffled)


@settings(max_examples=15)
@given(st.integers(0, 1000), st.integers(1, 6))
def test_few_points_of_any_size_work(seed, points):
    rng = np.random.default_rng(seed)
    x = np.repeat(rng.random((points, 2)), 5, axis=0)
    y = np.exp(rng.normal(0.0, 4.0, len(x)))
    outliers, reference = find_outliers(x, y, rng=rng)
    assert not outliers.all()
    assert np.isfinite(reference.predict(x)[0]).all()


@pytest.mark.parametrize("value", [0.0, 0.2])
def test_constant_responses_have_no_outliers(value):
    x = np.repeat(np.random.default_rng(0).random((10, 2)), 5, axis=0)
    y = np.full(len(x), value)
    assert not find_outliers(x, y, rng=np.random.default_rng(0))[0].any()


def test_one_huge_value_among_equal_ones():
    x = np.random.default_rng(0).random((20, 2))
    y = np.full(20, 0.15)
    y[7] = 40.0
    outliers = find_outliers(x, y, rng=np.random.default_rng(0))[0]
    np.testing.assert_array_equal(np.flatnonzero(outliers), [7])
