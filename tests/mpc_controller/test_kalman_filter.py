"""The filter against the Riccati equation, a batch least-squares estimate and statistics."""

import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.linalg import block_diag, cholesky, solve_discrete_are

from feed_axis_common.model import (
    delay_augmented,
    disturbance_augmented,
    feed_axis,
    zero_order_hold,
)
from mpc_controller.kalman_filter import kalman_filter
from mpc_controller.settings import default_settings

SAMPLE_TIME = 0.02


def make_model(delay=1.0, damping=1.0, disturbance=False):
    axis = feed_axis(1.0, damping, 26.0)
    model = delay_augmented(*axis, SAMPLE_TIME, delay * SAMPLE_TIME)
    return (
        disturbance_augmented(model, zero_order_hold(*axis, SAMPLE_TIME)[1])
        if disturbance
        else model
    )


@pytest.mark.parametrize("lambda_kf", [-5.0, -1.0, 2.0])
@pytest.mark.parametrize("delay", [0.0, 1.0, 2.5])
def test_covariance_and_gain_converge_to_the_riccati_solution(delay, lambda_kf):
    model, R = make_model(delay), 0.001
    kf = kalman_filter(model, R, lambda_kf, np.zeros(model.A.shape[0]))
    for _ in range(400):
        kf.update(0.0)
        kf.predict(0.0)
    Q = 10.0**lambda_kf * np.eye(model.A.shape[0])
    P = solve_discrete_are(model.A.T, model.C.T, Q, np.array([[R]]))
    np.testing.assert_allclose(kf.P, P, rtol=1e-6, atol=1e-9 * P.max())
    kf.update(0.0)
    gain = P @ model.C.T / ((model.C @ P @ model.C.T).item() + R)
    np.testing.assert_allclose(kf.K, gain, rtol=1e-6, atol=1e-9 * abs(gain).max())


@pytest.mark.parametrize("lambda_disturbance", [-2.0, 0.0])
@pytest.mark.parametrize("lambda_kf", [-4.0, -1.0])
@pytest.mark.parametrize("delay", [0.0, 1.0, 2.5])
def test_gain_with_a_disturbance_converges_to_the_riccati_solution(
    delay, lambda_kf, lambda_disturbance
):
    model, R = make_model(delay, disturbance=True), 0.001
    n = model.A.shape[0]
    kf = kalman_filter(model, R, lambda_kf, np.zeros(n), lambda_disturbance)
    variances = np.full(n, 10.0**lambda_kf)
    variances[2] = 10.0 ** (lambda_kf + lambda_disturbance)
    for _ in range(1000):
        kf.update(0.0)
        kf.predict(0.0)
    kf.update(0.0)
    P = solve_discrete_are(model.A.T, model.C.T, np.diag(variances), np.array([[R]]))
    gain = P @ model.C.T / ((model.C @ P @ model.C.T).item() + R)
    np.testing.assert_allclose(kf.K, gain, rtol=1e-6, atol=1e-9 * abs(gain).max())


def test_a_disturbance_is_followed_within_the_samples_that_the_documents_name():
    """With exact measurements, the time constant in samples is sqrt(H H' / 10^lambda_disturbance).

    H is the static gain from the process noise of each state to the velocity; that of the
    disturbance is K = 1. A random walk of variance q seen through white noise of variance r has the
    filter pole 1 - sqrt(q / r) for q << r.
    """
    model, plain = make_model(disturbance=True), make_model()
    H = plain.C @ np.linalg.inv(np.eye(3) - plain.A)
    for lambda_disturbance in (-4.0, -2.0, -1.0):
        kf = kalman_filter(model, 1e-9, 0.0, np.zeros(4), lambda_disturbance)
        for _ in range(2000):
            kf.update(0.0)
            kf.predict(0.0)
        poles = np.linalg.eigvals((np.eye(4) - kf.K @ model.C) @ model.A)
        time_constant = -1.0 / np.log(abs(poles).max())
        expected = np.sqrt((H @ H.T).item() / 10.0**lambda_disturbance)
        assert time_constant == pytest.approx(expected, rel=0.02)
    page = (Path(__file__).parents[2] / "docs" / "method.md").read_text()
    told = re.search(r"([\d.]+) · 10\^\(-λ_d / 2\), (\d+) samples with the default λ_d = -1", page)
    assert default_settings().lambda_disturbance == lambda_disturbance == -1.0
    assert told.groups() == (f"{np.sqrt((H @ H.T).item()):.1f}", f"{expected:.0f}")


@pytest.mark.parametrize("delay", [0.0, 1.0, 2.5])
def test_estimate_is_the_most_probable_state_of_the_whole_record(delay):
    """Filtering equals one weighted least-squares problem over all states of the record."""
    model, R, lambda_kf, samples = make_model(delay, 0.6), 0.01, -1.0, 7
    n = model.A.shape[0]
    rng = np.random.default_rng(2)
    u, y, x0 = rng.normal(size=samples - 1), rng.normal(size=samples), rng.normal(size=n)

    kf = kalman_filter(model, R, lambda_kf, x0)
    for k in range(samples):
        kf.update(y[k])
        if k < samples - 1:
            kf.predict(u[k])

    rows = [np.eye(n, samples * n)]
    target = [x0]
    for k in range(samples - 1):
        row = np.zeros((n, samples * n))
        row[:, k * n : (k + 1) * n] = -model.A
        row[:, (k + 1) * n : (k + 2) * n] = np.eye(n)
        rows.append(row)
        target.append(model.B[:, 0] * u[k])
    weight = 10.0 ** (-lambda_kf / 2)
    measured = block_diag(*[model.C] * samples)
    matrix = np.vstack([weight * np.vstack(rows), measured / np.sqrt(R)])
    vector = np.concatenate([weight * np.concatenate(target), y / np.sqrt(R)])
    states = np.linalg.lstsq(matrix, vector, rcond=None)[0].reshape(samples, n)
    np.testing.assert_allclose(kf.x[:, 0], states[-1], rtol=1e-7, atol=1e-8 * abs(states).max())


@given(
    delay=st.floats(0.0, 4.0),
    damping=st.floats(0.05, 3.0),
    lambda_kf=st.floats(-12.0, 8.0),
    variance_exponent=st.floats(-12.0, 6.0),
    lambda_disturbance=st.none() | st.floats(-12.0, 4.0),
    gaps=st.integers(0, 5),
)
def test_covariance_stays_symmetric_positive_semidefinite(
    delay, damping, lambda_kf, variance_exponent, lambda_disturbance, gaps
):
    model = make_model(delay, damping, disturbance=lambda_disturbance is not None)
    x0 = np.zeros(model.A.shape[0])
    kf = kalman_filter(model, 10.0**variance_exponent, lambda_kf, x0, lambda_disturbance or 0.0)
    for k in range(60):
        if k % (gaps + 1) == 0:
            kf.update(1.0)
        kf.predict(1.0)
        np.testing.assert_allclose(kf.P, kf.P.T, rtol=0, atol=1e-12 * abs(kf.P).max())
        eigenvalues = np.linalg.eigvalsh(0.5 * (kf.P + kf.P.T))
        assert eigenvalues[0] >= -1e-12 * eigenvalues[-1]


def test_innovations_of_a_matching_system_are_white_with_the_predicted_variance():
    model, R, lambda_kf, samples = make_model(1.0, 0.7), 0.001, -3.0, 4000
    n = model.A.shape[0]
    rng = np.random.default_rng(3)
    root = cholesky(10.0**lambda_kf * np.eye(n), lower=True)
    kf = kalman_filter(model, R, lambda_kf, np.zeros(n))
    x = root @ rng.normal(size=n)
    innovations = []
    for k in range(samples):
        y = (model.C @ x).item() + np.sqrt(R) * rng.normal()
        variance = (model.C @ kf.P @ model.C.T).item() + R
        innovations.append((y - kf.x[0, 0]) / np.sqrt(variance))
        kf.update(y)
        u = np.sin(0.1 * k)
        kf.predict(u)
        x = model.A @ x + model.B[:, 0] * u + root @ rng.normal(size=n)
    e = np.array(innovations)
    # Four standard deviations of the mean square and of the correlation of white noise.
    assert np.mean(e**2) == pytest.approx(1.0, abs=4 * np.sqrt(2 / samples))
    for lag in (1, 2, 5):
        assert np.mean(e[lag:] * e[:-lag]) == pytest.approx(0.0, abs=4 / np.sqrt(samples))


def test_without_noise_the_estimate_stays_on_the_true_state():
    model = make_model(1.5, 0.7)
    x = model.equilibrium(0.5, 1.0)
    kf = kalman_filter(model, 0.001, -1.0, x)
    for k in range(50):
        np.testing.assert_allclose(kf.x[:, 0], x, atol=1e-12)
        kf.update((model.C @ x).item())
        u = 0.5 + 0.3 * np.sin(0.4 * k)
        kf.predict(u)
        x = model.A @ x + model.B[:, 0] * u


def test_filters_share_no_state():
    model = make_model()
    x0 = np.ones(3)
    first = kalman_filter(model, 0.001, -1.0, x0)
    first.update(5.0)
    first.predict(5.0)
    second = kalman_filter(model, 0.001, -1.0, x0)
    np.testing.assert_array_equal(second.x[:, 0], np.ones(3))
    np.testing.assert_array_equal(second.P, 0.1 * np.eye(3))
    np.testing.assert_array_equal(x0, np.ones(3))
