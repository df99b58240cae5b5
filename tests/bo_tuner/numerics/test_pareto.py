"""Nondominated points, against their definition."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from bo_tuner.numerics.pareto import nondominated

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
