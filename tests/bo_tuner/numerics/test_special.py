"""Special functions against quadrature, asymptotics and scipy, with extreme inputs."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import quad
from scipy.stats import norm, t

from bo_tuner.numerics.special import (
    log_expected_improvement,
    log_h,
    log_normal_cdf,
    log_normal_pdf,
    log_student_t_pdf,
)


def log_h_by_quadrature(z):
    """h(z) = ∫₀^∞ s φ(s - z) ds; for z < 0 with φ(z) and the scale 1/|z| taken out."""
    if z >= 0.0:
        return np.log(quad(lambda s: s * norm.pdf(s - z), 0.0, z + 40.0, epsabs=1e-14)[0])
    scale = max(1.0, -z)
    integral = quad(
        lambda u: u * np.exp(z / scale * u - 0.5 * (u / scale) ** 2), 0.0, 60.0, epsabs=1e-14
    )[0]
    return norm.logpdf(z) + np.log(integral) - 2.0 * np.log(scale)


@pytest.mark.parametrize(
    "z", [-1e4, -1e3, -101.0, -100.0, -99.0, -30.0, -5.0, -1.001, -1.0, -0.999, 0.0, 0.5, 4.0, 20.0]
)
def test_log_h_equals_the_integral(z):
    assert log_h(np.array([z]))[0] == pytest.approx(log_h_by_quadrature(z), rel=1e-10)


def test_log_h_far_below_follows_its_limit():
    z = np.array([-1e6, -1e9, -1e15])
    # h(z) → φ(z) / z²
    np.testing.assert_allclose(log_h(z), norm.logpdf(z) - 2.0 * np.log(-z), rtol=1e-13)


def test_log_h_far_above_is_the_improvement_itself():
    z = np.array([50.0, 1e6, 1e15])
    np.testing.assert_allclose(log_h(z), np.log(z), rtol=1e-14)


@settings(max_examples=60)
@given(
    st.floats(-1e300, 1e300, allow_nan=False),
    st.floats(-1e300, 1e300, allow_nan=False),
)
def test_log_h_is_finite_and_does_not_decrease(a, b):
    low, high = log_h(np.array([min(a, b), max(a, b)]))
    assert np.isfinite([low, high]).all()
    assert low <= high + 1e-12 * abs(high)


def test_log_h_has_no_jump_where_its_formula_changes():
    for border in (-1.0, -100.0):
        below, above = log_h(np.array([np.nextafter(border, -np.inf), border]))
        assert below == pytest.approx(above, rel=1e-12)


def test_log_normal_functions_equal_scipy_and_stay_finite():
    z = np.linspace(-30.0, 30.0, 61)
    np.testing.assert_allclose(log_normal_pdf(z), norm.logpdf(z), rtol=1e-14)
    np.testing.assert_allclose(log_normal_cdf(z), norm.logcdf(z), rtol=1e-12)
    extreme = np.array([-np.inf, -1e200, -1e20, 1e20, np.inf])
    assert np.isfinite(log_normal_cdf(extreme)).all()
    assert np.isfinite(log_normal_pdf(extreme)).all()


@pytest.mark.parametrize("nu", [2.5, 4.0, 30.0])
def test_log_student_t_equals_scipy(nu):
    residual = np.array([-1e6, -3.0, 0.0, 0.1, 7.0, 1e9])
    scale = np.array([1.0, 0.5, 2.0, 1e-3, 1.0, 10.0])
    expected = t.logpdf(residual, nu, scale=scale)
    np.testing.assert_allclose(log_student_t_pdf(residual, scale, nu), expected, rtol=1e-10)


def test_log_expected_improvement_equals_the_closed_form():
    mean = np.array([-1.0, 0.0, 0.7, 2.0])
    variance = np.array([0.5, 1.0, 0.01, 4.0])
    best, sd = 0.3, np.sqrt(variance)
    z = (best - mean) / sd
    expected = np.log((best - mean) * norm.cdf(z) + sd * norm.pdf(z))
    np.testing.assert_allclose(log_expected_improvement(mean, variance, best), expected, rtol=1e-9)


def test_log_expected_improvement_is_finite_for_tiny_variances():
    variance = np.array([1e-30, 1e-30, 1e-300, 1.0])
    mean = np.array([1.0, -1.0, 1.0, 1e3])
    value = log_expected_improvement(mean, variance, 0.0)
    assert np.isfinite(value).all()
    assert value[1] == pytest.approx(0.0, abs=1e-12)  # improvement of 1 for certain
    # a thousand standard deviations below: log φ(z) - 2 log |z| to first order
    assert value[3] == pytest.approx(-0.5e6 - 0.5 * np.log(2.0 * np.pi) - np.log(1e6), rel=1e-9)


def test_known_values_are_worth_nothing():
    value = log_expected_improvement(np.array([-5.0, 5.0]), np.zeros(2), 0.0)
    assert (value == -np.inf).all()
