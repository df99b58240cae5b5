"""The particle swarm on functions with a known maximum."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bo_tuner.numerics.particle_swarm import SwarmSettings, maximize

THOROUGH = SwarmSettings(particles=60, iterations=200, stall=40, tolerance=1e-9)


def bowl(x):
    return -((x - 0.3) ** 2).sum(axis=1)


def rastrigin(x):
    z = 8.0 * (x - 0.6)
    return -(z**2 - 10.0 * np.cos(2.0 * np.pi * z) + 10.0).sum(axis=1)


def branin(x):
    a, b = 15.0 * x[:, 0] - 5.0, 15.0 * x[:, 1]
    curve = b - 5.1 / (4.0 * np.pi**2) * a**2 + 5.0 / np.pi * a - 6.0
    return -(curve**2 + 10.0 * (1.0 - 1.0 / (8.0 * np.pi)) * np.cos(a) + 10.0)


@pytest.mark.parametrize(
    ("function", "dimension", "maximum", "accuracy"),
    [
        (bowl, 1, 0.0, 1e-6),
        (bowl, 6, 0.0, 1e-5),
        (rastrigin, 2, 0.0, 1e-4),
        (branin, 2, -0.397887, 1e-4),
    ],
)
def test_known_maxima(function, dimension, maximum, accuracy):
    result = maximize(function, dimension, np.random.default_rng(0), settings=THOROUGH)
    assert result.value == pytest.approx(maximum, abs=accuracy)
    assert function(result.position[None])[0] == result.value


def test_maximum_in_a_corner():
    result = maximize(lambda x: x.sum(axis=1), 4, np.random.default_rng(0), settings=THOROUGH)
    np.testing.assert_array_equal(result.position, np.ones(4))


def round_first(x):
    """First coordinate: an integer 0…10; second: at least the first."""
    repaired = x.copy()
    repaired[:, 0] = np.round(10.0 * x[:, 0]) / 10.0
    repaired[:, 1] = np.maximum(x[:, 1], repaired[:, 0])
    return repaired


def test_mixed_space_with_an_order_constraint():
    def objective(x):
        assert np.allclose(10.0 * x[:, 0], np.round(10.0 * x[:, 0]))
        assert (x[:, 1] >= x[:, 0]).all()
        return -((x[:, 0] - 0.74) ** 2) - (x[:, 1] - 0.2) ** 2

    result = maximize(objective, 2, np.random.default_rng(0), repair=round_first, settings=THOROUGH)
    # on the line x₁ = x₀, the nearest tenth to the mean of 0.74 and 0.2
    np.testing.assert_allclose(result.position, [0.5, 0.5])


def test_one_integer_only():
    def repair(x):
        return np.round(3.0 * x) / 3.0

    result = maximize(bowl, 1, np.random.default_rng(0), repair=repair)
    np.testing.assert_allclose(result.position, [1.0 / 3.0])


def test_excluded_everywhere():
    result = maximize(
        lambda x: np.full(len(x), -np.inf), 3, np.random.default_rng(0), repair=lambda x: x
    )
    assert result.value == -np.inf
    assert ((result.position >= 0.0) & (result.position <= 1.0)).all()


def test_excluded_almost_everywhere_and_nan():
    def objective(x):
        value = np.where(x[:, 0] > 0.9, x[:, 1], -np.inf)
        value[x[:, 1] > 0.95] = np.nan
        return value

    result = maximize(objective, 2, np.random.default_rng(0), settings=THOROUGH)
    assert result.position[0] > 0.9
    assert result.value == pytest.approx(0.95, abs=1e-3)


def test_a_given_particle_is_not_lost():
    needle = np.array([0.123, 0.456])

    def objective(x):
        return np.where((np.abs(x - needle) < 1e-9).all(axis=1), 1.0, 0.0)

    result = maximize(objective, 2, np.random.default_rng(0), initial=needle[None])
    np.testing.assert_array_equal(result.position, needle)
    assert result.value == 1.0


@settings(max_examples=15)
@given(st.integers(0, 1000), st.integers(1, 6))
def test_positions_stay_in_the_box_and_a_seed_fixes_the_result(seed, dimension):
    seen = []

    def objective(x):
        seen.append(x.copy())
        return np.sin(40.0 * x).sum(axis=1)

    one = maximize(objective, dimension, np.random.default_rng(seed))
    other = maximize(objective, dimension, np.random.default_rng(seed))
    visited = np.concatenate(seen)
    assert ((visited >= 0.0) & (visited <= 1.0)).all()
    np.testing.assert_array_equal(one.position, other.position)
    assert one.value == other.value == np.sin(40.0 * visited).sum(axis=1).max()


def test_no_progress_stops_the_search():
    few = SwarmSettings(particles=10, iterations=100, stall=3)
    counts = []

    def flat(x):
        counts.append(len(x))
        return np.zeros(len(x))

    maximize(flat, 2, np.random.default_rng(0), settings=few)
    assert counts == [10] * 4


def test_values_that_improve_nothing_do_not_matter():
    def improved(known, x):
        value = rastrigin(x)
        return np.where(value > known, value, np.nan)

    whole = maximize(rastrigin, 2, np.random.default_rng(0))
    found = maximize(rastrigin, 2, np.random.default_rng(0), improved=improved)
    np.testing.assert_array_equal(found.position, whole.position)
    assert found.value == whole.value


def test_more_given_particles_than_the_swarm_has():
    given_positions = np.random.default_rng(1).random((20, 2))
    few = SwarmSettings(particles=5, iterations=1)
    counts = []

    def objective(x):
        counts.append(len(x))
        return bowl(x)

    maximize(objective, 2, np.random.default_rng(0), initial=given_positions, settings=few)
    assert counts == [20, 20]


def test_bad_arguments_are_refused():
    with pytest.raises(ValueError, match=r"initial: expected shape \(k, 2\), found \(4, 3\)"):
        maximize(bowl, 2, np.random.default_rng(0), initial=np.zeros((4, 3)))
    with pytest.raises(ValueError, match="particles: expected at least 1, found 0"):
        SwarmSettings(particles=0)
    with pytest.raises(ValueError, match="tolerance: expected >= 0, found nan"):
        SwarmSettings(tolerance=np.nan)
