"""Choices without an order in the models."""

import itertools

import numpy as np
import pytest

from bo_tuner.models.categories import Coding, coded_fit
from bo_tuner.models.gaussian_process import GaussianProcess
from bo_tuner.models.hyperpriors import Hyperparameters
from bo_tuner.models.kernel import MEAN_SD, latent_covariance

CODING = Coding((0, 3, 0))
CHOICES = np.array([0.0, 0.5, 1.0])


def points(count=30):
    rng = np.random.default_rng(4)
    x = rng.uniform(size=(count, 3))
    x[:, 1] = rng.choice(CHOICES, count)
    return x


def test_codes_read_back():
    x = points()
    assert CODING.encode(x).shape == (30, 5)
    assert np.array_equal(CODING.decode(CODING.encode(x)), x)
    assert CODING.names(["a", "b", "c"]) == ["a", "b.0", "b.1", "b.2", "c"]
    assert CODING.spread([1.0, 2.0, 3.0]).tolist() == [1.0, 2.0, 2.0, 2.0, 3.0]
    assert CODING.least(np.array([1.0, 5.0, 4.0, 6.0, 3.0])).tolist() == [1.0, 4.0, 3.0]


def test_every_two_choices_are_equally_far():
    x = CODING.encode([[0.2, choice, 0.7] for choice in CHOICES])
    for a, b in itertools.combinations(x, 2):
        assert np.sum((a - b) ** 2) == pytest.approx(1.0)


def test_equal_length_scales_give_the_weighted_hamming_kernel():
    """Hutter, Hoos and Leyton-Brown (2011), Section 4.1, beside the columns of numbers."""
    x, scales, signal = points(8), np.array([0.3, 0.8, 0.5]), 1.7
    hyperparameters = Hyperparameters(CODING.spread(scales), signal, 0.1)
    found = latent_covariance(hyperparameters, CODING.encode(x), CODING.encode(x))
    for i, j in itertools.product(range(8), repeat=2):
        numbers = ((x[i] - x[j])[[0, 2]] ** 2 / scales[[0, 2]] ** 2).sum()
        differ = float(x[i, 1] != x[j, 1]) / scales[1] ** 2
        expected = MEAN_SD**2 + signal**2 * np.exp(-0.5 * (numbers + differ))
        assert found[i, j] == pytest.approx(expected, rel=1e-12)


def test_the_order_in_which_choices_are_listed_does_not_matter():
    x = points()
    best = {0.0: 2.0, 0.5: 0.0, 1.0: 1.0}
    y = x[:, 0] + np.array([best[choice] for choice in x[:, 1]])
    renamed = {0.0: 0.5, 0.5: 1.0, 1.0: 0.0}
    z = x.copy()
    z[:, 1] = [renamed[choice] for choice in x[:, 1]]
    fit = coded_fit(GaussianProcess.fit, CODING)
    one, other = (fit(at, y, rng=np.random.default_rng(1)) for at in (x, z))
    assert one.predict_mean(x) == pytest.approx(other.predict_mean(z), abs=0.05)
    assert one.predict_mean(x) == pytest.approx(y, abs=0.2)
    assert one.points.shape[1] == 3
    assert one.length_scales.shape == (3,)


def test_without_choices_nothing_is_coded():
    plain = Coding((0, 0, 0))
    assert coded_fit(GaussianProcess.fit, plain) == GaussianProcess.fit
