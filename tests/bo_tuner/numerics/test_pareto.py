"""Nondominated points and hypervolume, against their definitions."""

from itertools import chain, combinations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from bo_tuner.numerics.pareto import hypervolume, nondominated

# A coarse grid, so that ties are frequent.
GRID = st.integers(0, 5).map(float)
POINTS = st.tuples(st.integers(1, 7), st.integers(1, 3)).flatmap(
    lambda shape: arrays(np.float64, shape, elements=GRID)
)


@given(POINTS)
def test_each_point_is_judged_by_the_definition(costs):
    found = nondominated(costs)
    for k, point in enumerate(costs):
        dominated = any((other <= point).all() and (other < point).any() for other in costs) or any(
            (other == point).all() for other in costs[:k]
        )
        assert found[k] != dominated


def by_inclusion_and_exclusion(costs, reference):
    """Volume of a union of boxes: those of all subsets, with alternating signs."""
    boxes = [row for row in costs if (row < reference).all()]
    subsets = chain.from_iterable(combinations(boxes, n) for n in range(1, len(boxes) + 1))
    return sum(
        (-1) ** (len(subset) + 1) * np.prod(reference - np.max(subset, axis=0))
        for subset in subsets
    )


@given(POINTS)
def test_hypervolume_is_that_of_the_union_of_boxes(costs):
    reference = np.full(costs.shape[1], 4.5)
    expected = by_inclusion_and_exclusion(costs, reference)
    assert hypervolume(costs, reference) == pytest.approx(expected)
    front = costs[nondominated(costs)]
    assert hypervolume(front, reference) == pytest.approx(expected)


def test_hypervolume_of_a_quarter_of_a_disc():
    angles = np.linspace(0.0, 0.5 * np.pi, 2001)
    costs = 1.0 - np.column_stack([np.cos(angles), np.sin(angles)])
    assert hypervolume(costs, np.ones(2)) == pytest.approx(0.25 * np.pi, abs=1e-3)


def test_nothing_within_the_reference():
    assert hypervolume(np.array([[1.0, 0.0]]), np.ones(2)) == 0.0
    assert hypervolume(np.empty((0, 2)), np.ones(2)) == 0.0
