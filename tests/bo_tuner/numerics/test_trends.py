"""A trend by ranks, against SciPy."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from bo_tuner.numerics.trends import trend


@given(st.lists(st.integers(-5, 5), min_size=10, max_size=40).filter(lambda v: len(set(v)) > 1))
def test_it_is_spearmans_with_ties(values):
    expected = stats.spearmanr(values, np.arange(len(values)))
    rho, p_value = trend(np.array(values, dtype=float))
    assert rho == pytest.approx(expected.statistic, abs=1e-12)
    assert p_value == pytest.approx(expected.pvalue, rel=1e-6, abs=1e-12)


@pytest.mark.parametrize("values", [np.ones(30), np.arange(9.0), np.empty(0)])
def test_what_says_nothing(values):
    assert trend(values) == (0.0, 1.0)


def test_an_order_without_exception_is_no_chance():
    assert trend(np.arange(30.0)) == (pytest.approx(1.0), pytest.approx(0.0, abs=1e-9))
