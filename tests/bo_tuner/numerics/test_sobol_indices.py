"""Total indices against closed forms: the function of Ishigami, and the g-function of Sobol'."""

from math import pi

import numpy as np
import pytest

from bo_tuner.numerics.sobol_indices import total_indices


@pytest.mark.parametrize(("a", "b"), [(7.0, 0.1), (7.0, 0.05), (2.0, 0.2)])
def test_the_function_of_ishigami(a, b):
    """Ishigami and Homma (1990): sin x1 + a sin² x2 + b x3⁴ sin x1 on [-π, π]³."""

    def function(cube):
        x = (2.0 * cube - 1.0) * pi
        return np.sin(x[:, 0]) + a * np.sin(x[:, 1]) ** 2 + b * x[:, 2] ** 4 * np.sin(x[:, 0])

    alone = 0.5 * (1.0 + b * pi**4 / 5.0) ** 2
    second = a**2 / 8.0
    together = b**2 * pi**8 * (1.0 / 18.0 - 1.0 / 50.0)
    total = alone + second + together
    expected = np.array([alone + together, second, together]) / total
    np.testing.assert_allclose(total_indices(function, 3), expected, atol=0.03)


def test_the_g_function_of_sobol():
    """Sobol' (1998): product of (|4 x - 2| + a) / (1 + a), in closed form for any dimension."""
    a = np.array([0.0, 1.0, 4.5, 9.0, 99.0])

    def function(cube):
        return np.prod((np.abs(4.0 * cube - 2.0) + a) / (1.0 + a), axis=1)

    own = 1.0 / (3.0 * (1.0 + a) ** 2)
    variance = np.prod(1.0 + own) - 1.0
    expected = own * np.prod(1.0 + own) / (1.0 + own) / variance
    np.testing.assert_allclose(total_indices(function, 5), expected, atol=0.03)


def test_what_has_no_effect_and_what_has_all():
    found = total_indices(lambda cube: 3.0 + 5.0 * cube[:, 1], 2)
    np.testing.assert_allclose(found, [0.0, 1.0], atol=0.01)


def test_a_constant_has_none():
    assert np.isnan(total_indices(lambda cube: np.full(len(cube), 4.0), 2)).all()
