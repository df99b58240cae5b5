"""The random metrics on which bands are judged: their scale, their worst mean, their noise."""

import numpy as np
import pytest
from synthetic_responses import KINDS, LOUDER, NOISE, largest, response


def test_the_largest_value_of_a_function():
    """A cone beside a lower one, and a plane whose largest value is in a corner."""

    def cones(u):
        one, other = (np.linalg.norm(u - at, axis=1) for at in ([0.2, 0.7], [0.9, 0.1]))
        return np.maximum(1.0 - one, 0.9 - other)

    value, where = largest(cones, 2)
    assert value == pytest.approx(1.0, abs=1e-3)
    assert where == pytest.approx([0.2, 0.7], abs=1e-3)
    value, where = largest(lambda u: u @ [1.0, -2.0, 3.0], 3)
    assert (value, list(where)) == (pytest.approx(4.0), pytest.approx([1.0, 0.0, 1.0]))


def test_responses():
    kinds, dimensions = set(), set()
    for seed in range(40):
        found = response(np.random.default_rng(seed))
        kinds.add(found.kind)
        dimensions.add(found.dimension)
        u = np.random.default_rng(0).random((20_000, found.dimension))
        values = found.mean(u)
        assert values.mean() == pytest.approx(0.0, abs=0.15)
        assert values.std() == pytest.approx(1.0, abs=0.1)
        assert values.max() <= found.worst + 1e-6
        assert found.mean(found.where[None])[0] == pytest.approx(found.worst)
        noise = found.deviation(u)
        assert NOISE[0] / LOUDER**0.5 <= noise.min() <= noise.max() <= NOISE[1] * LOUDER**0.5
        assert bool(noise.max() > noise.min()) is found.heteroscedastic
    assert kinds == set(KINDS)
    assert dimensions == {1, 2, 3}
