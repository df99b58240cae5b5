"""The defining property: every stratum of every dimension holds one point."""

import numpy as np
import pytest

from bo_tuner.numerics.latin_hypercube import latin_hypercube


@pytest.mark.parametrize(("count", "dimension"), [(1, 1), (7, 3), (40, 12)])
def test_one_point_in_each_stratum(count, dimension):
    points = latin_hypercube(count, dimension, np.random.default_rng(0))
    assert points.shape == (count, dimension)
    for column in np.floor(points * count).T:
        assert sorted(column) == list(range(count))


def test_nothing_to_draw():
    assert latin_hypercube(0, 2, np.random.default_rng(0)).shape == (0, 2)
    assert latin_hypercube(3, 0, np.random.default_rng(0)).shape == (3, 0)
