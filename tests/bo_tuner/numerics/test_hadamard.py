"""Screening designs by what defines them: orthogonal columns, also to all pairs of columns."""

import itertools

import numpy as np
import pytest

from bo_tuner.numerics.hadamard import hadamard, screening_design


@pytest.mark.parametrize("order", [1, 2, 4, 8, 12, 16, 20, 24, 32, 40, 48, 60])
def test_a_hadamard_matrix(order):
    found = hadamard(order)
    assert set(np.unique(found)) <= {-1.0, 1.0}
    np.testing.assert_array_equal(found[:, 0], 1.0)
    np.testing.assert_array_equal(found.T @ found, order * np.eye(order))


def test_an_order_without_a_matrix_is_refused():
    with pytest.raises(ValueError, match="order"):
        hadamard(6)


@pytest.mark.parametrize("factors", [1, 3, 9, 11, 12, 23, 50])
def test_no_effect_is_mixed_with_another_one_or_with_one_of_two(factors):
    found = screening_design(factors, np.random.default_rng(factors))
    runs = len(found)
    assert runs <= 4 * (factors + 8)
    np.testing.assert_array_equal(found.T @ found, runs * np.eye(factors))
    np.testing.assert_array_equal(found.sum(axis=0), 0.0)
    for one, other in itertools.islice(itertools.combinations(range(factors), 2), 200):
        np.testing.assert_array_equal(found.T @ (found[:, one] * found[:, other]), 0.0)
