"""Quantiles by their definition, and a model that grows with the problem."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mpc_controller.return_time import (
    filter_operations,
    iteration_operations,
    program_operations,
    quantiles,
)


@given(st.lists(st.floats(0.0, 1.0), min_size=1, max_size=300))
def test_a_quantile_is_the_smallest_time_that_its_share_does_not_exceed(times):
    result = quantiles(times)
    ordered = sorted(times)
    for name, share in (("p50", 50), ("p96", 96), ("p99", 99)):
        rank = math.ceil(share * len(times) / 100)
        assert result[f"return_time_{name}"] == ordered[rank - 1]
    assert result["return_time_max"] == ordered[-1]


@pytest.mark.parametrize("n", range(1, 30))
def test_operations_grow_with_the_problem(n):
    assert 0 < filter_operations(n) < filter_operations(n + 1)
    assert 0 < program_operations(3, n, n + 5) < program_operations(3, n + 1, n + 5)
    assert program_operations(3, n, n) < program_operations(3, n, n + 1)
    assert 0 < iteration_operations(n) < iteration_operations(n + 1)


def test_operations_have_the_order_of_their_algorithms():
    """Cubic for the filter, quadratic for an iteration, bilinear for the linear term."""
    for count, order in (
        (filter_operations, 3),
        (iteration_operations, 2),
        (lambda n: program_operations(3, n, n), 2),
    ):
        assert math.log2(count(20_000) / count(10_000)) == pytest.approx(order, abs=0.01)
