"""Conditioning of a Gaussian process, against dense closed forms."""

import numpy as np
import pytest

from bo_tuner.models import conditioning
from bo_tuner.models.conditioning import Prior, choose_basis
from bo_tuner.models.hyperpriors import Hyperparameters
from bo_tuner.models.kernel import latent_covariance

THETA = Hyperparameters(length_scales=np.array([0.3, 0.5]), signal=1.5, noise=0.1)


@pytest.fixture
def data():
    """Points (n, 2), means (n,) and their variances (n,) of many orders of magnitude."""
    rng = np.random.default_rng(0)
    x = rng.random((60, 2))
    variances = 10.0 ** rng.uniform(-4.0, -1.0, len(x))
    mean = np.sin(6.0 * x[:, 0]) + x[:, 1] + np.sqrt(variances) * rng.standard_normal(len(x))
    return x, mean, variances


def condition(x, mean, variances, basis=None):
    return Prior(THETA, x, basis).condition(mean, variances)


def smoother(covariance, variances):
    """The matrix that takes observations to the posterior means at them."""
    return covariance @ np.linalg.inv(covariance + np.diag(variances))


def check(posterior, prior, cross, covariance, data, query):
    """Compare with dense algebra: prior (q,) and cross covariance (q, n), covariance (n, n)."""
    _, mean, variances = data
    gain = cross @ np.linalg.inv(covariance + np.diag(variances))
    kernel = latent_covariance(THETA, query, posterior.basis)
    assert kernel @ posterior.weights == pytest.approx(gain @ mean, abs=1e-8)
    explained = ((kernel @ posterior.whitening.T) ** 2).sum(axis=1)
    expected = prior - np.einsum("ij,ij->i", gain, cross)
    assert prior - explained == pytest.approx(expected, abs=1e-8)
    smooth = smoother(covariance, variances)
    assert posterior.leverages == pytest.approx(np.diag(smooth), abs=1e-8)
    assert posterior.residuals == pytest.approx(mean - smooth @ mean, abs=1e-8)
    assert posterior.warnings == ()


QUERY = np.random.default_rng(1).random((7, 2))
PRIOR = np.full(len(QUERY), 1.5**2 + 1.0)


def test_is_exact_with_few_points(data):
    x = data[0]
    assert choose_basis(THETA, x, data[2]) is None
    covariance = latent_covariance(THETA, x, x)
    cross = latent_covariance(THETA, QUERY, x)
    check(condition(*data), PRIOR, cross, covariance, data, QUERY)


def test_is_that_of_the_nystroem_covariance_on_a_basis(data):
    x, basis = data[0], np.arange(0, 60, 4)
    inverse = np.linalg.inv(latent_covariance(THETA, x[basis], x[basis]))
    with_data = latent_covariance(THETA, x, x[basis])
    cross = latent_covariance(THETA, QUERY, x[basis]) @ inverse @ with_data.T
    covariance = with_data @ inverse @ with_data.T
    check(condition(*data, basis), PRIOR, cross, covariance, data, QUERY)


def test_a_basis_of_all_points_is_exact(data):
    exact, projected = condition(*data), condition(*data, np.arange(60))
    kernel = latent_covariance(THETA, QUERY, data[0])
    assert kernel @ projected.weights == pytest.approx(kernel @ exact.weights, abs=1e-6)
    assert ((kernel @ projected.whitening.T) ** 2).sum(axis=1) == pytest.approx(
        ((kernel @ exact.whitening.T) ** 2).sum(axis=1), abs=1e-6
    )


def test_a_chosen_basis_loses_next_to_nothing(monkeypatch, data):
    monkeypatch.setattr(conditioning, "BASIS", 40)
    basis = choose_basis(THETA, data[0], data[2])
    assert len(basis) == len(set(basis.tolist())) <= 40
    exact, projected = condition(*data), condition(*data, basis)
    kernels = [latent_covariance(THETA, QUERY, p.basis) for p in (exact, projected)]
    means = [k @ p.weights for k, p in zip(kernels, (exact, projected), strict=True)]
    variances = [
        PRIOR - ((k @ p.whitening.T) ** 2).sum(axis=1)
        for k, p in zip(kernels, (exact, projected), strict=True)
    ]
    assert (np.abs(means[1] - means[0]) < 0.1 * np.sqrt(variances[0])).all()
    assert np.sqrt(variances[1]) == pytest.approx(np.sqrt(variances[0]), rel=0.1)


def test_points_that_the_basis_explains_are_left_out(monkeypatch):
    """A dense cluster with much noise needs one point for all of it."""
    monkeypatch.setattr(conditioning, "BASIS", 40)
    x = 0.5 + 1e-4 * np.random.default_rng(2).random((60, 2))
    assert len(choose_basis(THETA, x, np.full(60, 0.1))) == 1


def test_precise_points_come_first(monkeypatch, data):
    monkeypatch.setattr(conditioning, "BASIS", 1)
    variances = np.full(60, 0.1)
    variances[17] = 1e-3
    assert choose_basis(THETA, data[0], variances).tolist() == [17]
