"""The posterior of a metric over the context, against a grid of hyperparameters."""

import numpy as np
import pytest
from scipy.stats import multivariate_normal
from sklearn.gaussian_process.kernels import Matern

from bo_tuner.evidence.certificate import context_response
from bo_tuner.evidence.certificate.context_response import PRIORS, ContextResponse


def gridded(x, y, at):
    """Posterior mean and standard deviation at points, by a sum over a grid of hyperparameters.

    Both are in standard deviations of `y` from its mean, which the priors refer to.
    """
    axes = [
        np.log(prior.median) + prior.spread * np.linspace(-3.5, 3.5, 15)
        for prior in (PRIORS.length_scale, PRIORS.signal, PRIORS.noise)
    ]
    logs, means, squares = [], [], []
    for length, signal, noise in np.stack(np.meshgrid(*axes), -1).reshape(-1, 3):
        kernel = Matern(np.exp(length), nu=1.5)
        prior = np.exp(2 * signal) * kernel(np.vstack([x, at])) + 1.0
        n = len(x)
        noisy = prior[:n, :n] + np.exp(2 * noise) * np.eye(n)
        density = multivariate_normal(np.zeros(n), noisy).logpdf(y)
        for value, of in (
            (length, PRIORS.length_scale), (signal, PRIORS.signal), (noise, PRIORS.noise)
        ):  # fmt: skip
            density -= 0.5 * ((value - np.log(of.median)) / of.spread) ** 2
        logs.append(density)
        gain = np.linalg.solve(noisy, prior[:n, n:])
        means.append(gain.T @ y)
        squares.append(means[-1] ** 2 + np.diag(prior[n:, n:] - prior[n:, :n] @ gain))
    weights = np.exp(np.array(logs) - max(logs))
    weights /= weights.sum()
    mean = weights @ np.array(means)
    return mean, np.sqrt(weights @ np.array(squares) - mean**2)


def test_the_hyperparameters_are_averaged_over(monkeypatch):
    monkeypatch.setattr(context_response, "KEPT", 1500)
    # Equal noise everywhere, so that the reference need not know of local noise.
    monkeypatch.setattr(
        context_response.PooledProcess,
        "noise",
        lambda self, x, c, which: (np.full(len(x), self.noise_variance), None),
    )
    rng = np.random.default_rng(4)
    x = rng.random((9, 1))
    y = np.sin(5 * x[:, 0]) + 0.2 * rng.standard_normal(9)
    at = np.array([[0.0], [0.35], [0.8], [1.0]])
    response = ContextResponse(x, y, rng)
    expected, deviation = gridded(x, (y - y.mean()) / y.std(), at)
    sampled = (response.sample(at, 5, rng) - y.mean()) / y.std()
    assert sampled.mean(axis=0) == pytest.approx(expected, abs=0.08)
    assert sampled.std(axis=0) == pytest.approx(deviation, rel=0.12)
    assert (response.mean(at) - y.mean()) / y.std() == pytest.approx(expected, abs=0.08)


def test_the_noise_is_local():
    """Twenty runs at each end, with deviations of 0.05 and 0.5; the error of a mean is σ / √20."""
    rng = np.random.default_rng(1)
    ends = np.repeat([[0.0], [1.0]], 20, axis=0)
    inside = rng.random((30, 1))
    x = np.vstack([ends, inside])
    y = x[:, 0] + np.where(x[:, 0] > 0.5, 0.5, 0.05) * rng.standard_normal(len(x))
    low, high = ContextResponse(x, y, rng).sample(np.array([[0.0], [1.0]]), 100, rng).std(axis=0)
    assert low < 0.05
    assert high > 0.06


def test_without_any_variation():
    response = ContextResponse(
        np.random.default_rng(0).random((8, 2)), np.full(8, 3.0), np.random.default_rng(0)
    )
    assert response.mean(np.array([[0.5, 0.5]])) == pytest.approx(3.0)
