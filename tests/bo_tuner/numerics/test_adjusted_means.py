"""Adjusted means against SciPy's intervals, the sandwich formula and known expectations."""

from math import inf, isinf, isnan

import numpy as np
import pytest
from scipy import stats

from bo_tuner.numerics.adjusted_means import adjusted_mean


def test_without_covariates_it_is_students_interval():
    values = np.random.default_rng(1).normal(3.0, 2.0, 12)
    found = adjusted_mean(values, np.empty((12, 0)), 0.9)
    interval = stats.ttest_1samp(values, 0.0).confidence_interval(0.9)
    assert (found.low, found.high) == pytest.approx(tuple(interval), rel=1e-12)
    assert found.mean == pytest.approx(np.mean(values))
    assert found.error == pytest.approx(stats.sem(values))
    assert not found.adjusted


def test_it_is_the_intercept_with_the_sandwich_of_its_variance():
    """(XᵀX)⁻¹ Xᵀ diag(e² / (1 - l)²) X (XᵀX)⁻¹, written out."""
    rng = np.random.default_rng(2)
    covariates = rng.standard_normal((20, 3))
    values = 5.0 + covariates @ [1.0, -2.0, 0.5] + rng.standard_normal(20)
    x = np.column_stack([np.ones(20), covariates])
    inverse = np.linalg.inv(x.T @ x)
    beta = inverse @ x.T @ values
    errors = (values - x @ beta) / (1.0 - np.diag(x @ inverse @ x.T))
    variance = (inverse @ x.T @ np.diag(errors**2) @ x @ inverse)[0, 0]
    half = stats.t.ppf(0.975, 16) * np.sqrt(variance)
    found = adjusted_mean(values, covariates, 0.95)
    assert found.mean == pytest.approx(beta[0], rel=1e-12)
    assert found.error == pytest.approx(np.sqrt(variance))
    assert found.adjusted
    assert (found.low, found.high) == pytest.approx((beta[0] - half, beta[0] + half), rel=1e-9)


def test_a_response_that_the_covariates_explain_has_its_expectation_exactly():
    covariates = np.random.default_rng(3).standard_normal((10, 2))
    found = adjusted_mean(7.0 + covariates @ [3.0, 4.0], covariates, 0.95)
    assert (found.mean, found.low, found.high) == pytest.approx((7.0, 7.0, 7.0))


def test_equal_values_have_no_scatter():
    covariates = np.random.default_rng(4).standard_normal((10, 2))
    found = adjusted_mean(np.full(10, 0.3), covariates, 0.95)
    assert (found.mean, found.low, found.high) == (0.3, 0.3, 0.3)
    assert found.error < 1e-16


@pytest.mark.parametrize("column", [np.zeros(10), np.ones(10), np.eye(10)[0]])
def test_covariates_that_the_draws_do_not_tell_apart_are_left_out(column):
    """One that is constant by chance, or differs in a single draw alone."""
    values = np.random.default_rng(5).standard_normal(10)
    found = adjusted_mean(values, column[:, None], 0.95)
    assert found == adjusted_mean(values, np.empty((10, 0)), 0.95)


def test_too_few_values_bound_nothing():
    one = adjusted_mean(np.array([2.0]), np.empty((1, 0)), 0.95)
    assert (one.mean, one.low, one.high, one.adjusted) == (2.0, -inf, inf, False)
    assert isnan(one.error)
    none = adjusted_mean(np.empty(0), np.empty((0, 0)), 0.95)
    assert isnan(none.mean)
    assert isinf(none.low)


def test_the_interval_holds_the_expectation_as_often_as_it_says():
    """Of a response with a curve that the covariates do not have, in 25 draws: 95 % of 1000."""
    rng = np.random.default_rng(6)
    held = 0
    for _ in range(1000):
        u = rng.random(25)
        values = np.exp(2.0 * u) + 0.1 * rng.standard_normal(25)
        found = adjusted_mean(values, (u - 0.5)[:, None], 0.95)
        held += found.low <= 0.5 * (np.exp(2.0) - 1.0) <= found.high
    assert held >= 915
