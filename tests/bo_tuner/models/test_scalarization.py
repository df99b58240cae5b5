"""The augmented Chebyshev scalarization, against its equation and its properties."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from bo_tuner.models.scalarization import AUGMENTATION, BEYOND, Chebyshev, equal_weights

COSTS = st.integers(2, 3).flatmap(
    lambda k: arrays(np.float64, (6, k), elements=st.floats(-10.0, 10.0))
)


def of_equation(costs, weights, ideal, nadir):
    utopian = [z - BEYOND * (n - z) for z, n in zip(ideal, nadir, strict=True)]
    scaled = [(c - u) / (n - z) for c, u, z, n in zip(costs, utopian, ideal, nadir, strict=True)]
    weighted = [w * f for w, f in zip(weights, scaled, strict=True)]
    return max(weighted) + AUGMENTATION * sum(weighted)


@given(COSTS, st.integers(0, 2**31))
def test_it_is_that_of_the_equation(costs, seed):
    k = costs.shape[1]
    weights = np.random.default_rng(seed).dirichlet(np.ones(k))
    ideal, nadir = np.arange(k) - 3.0, np.arange(k) + 2.0
    found = Chebyshev(weights, ideal, nadir)(costs)
    assert found == pytest.approx([of_equation(row, weights, ideal, nadir) for row in costs])


@given(COSTS, st.integers(0, 2**31))
def test_the_mean_of_the_linearized_values_is_the_value_of_the_mean(costs, seed):
    k = costs.shape[1]
    weights = np.random.default_rng(seed).dirichlet(np.ones(k))
    chebyshev = Chebyshev(weights, np.zeros(k), np.full(k, 2.0))
    (of_mean,) = chebyshev(costs.mean(axis=0)[None])
    assert chebyshev.linearized(costs).mean() == pytest.approx(of_mean, abs=1e-9)


def test_the_scale_is_that_of_the_feasible_front():
    means = np.array([[0.0, 4.0], [1.0, 2.0], [3.0, 1.0], [5.0, 5.0], [-9.0, -9.0]])
    feasible = np.array([True, True, True, True, False])
    found = Chebyshev.between(means, feasible, equal_weights(2))
    assert found.ideal.tolist() == [0.0, 1.0]
    assert found.nadir.tolist() == [3.0, 4.0]


def test_a_narrow_front_is_as_wide_as_half_of_all_trials():
    """One that is better than almost all in both costs says nothing of where the front ends."""
    others = np.array([[4.0, 7.0], [5.0, 6.0], [6.0, 8.0], [9.0, 9.0]])
    means = np.vstack([[1.0, 1.1], [1.1, 1.0], others])
    found = Chebyshev.between(means, np.ones(6, dtype=bool), equal_weights(2))
    assert found.ideal.tolist() == [1.0, 1.0]
    assert found.nadir.tolist() == [4.5, 6.5]


def test_a_front_of_one_point_is_scaled_by_all():
    means = np.array([[0.0, 0.0], [1.0, 2.0], [3.0, 1.0]])
    found = Chebyshev.between(means, np.ones(3, dtype=bool), equal_weights(2))
    assert (found.nadir > found.ideal).all()
    alone = Chebyshev.between(means[:1], np.zeros(1, dtype=bool), equal_weights(2))
    assert np.isfinite(alone(means)).all()


def test_equal_weights_choose_the_point_nearest_to_the_ideal():
    """On the front f2 = 1 - f1 that is the middle."""
    first = np.linspace(0.0, 1.0, 101)
    costs = np.column_stack([first, 1.0 - first])
    chebyshev = Chebyshev.between(costs, np.ones(101, dtype=bool), equal_weights(2))
    assert first[np.argmin(chebyshev(costs))] == pytest.approx(0.5)


def test_some_weights_lead_beyond_either_end_of_the_front_seen():
    """Of a front f2 = 1 - f1 its middle was seen."""
    first = np.linspace(0.0, 1.0, 101)
    front = np.column_stack([first, 1.0 - first])
    seen = front[40:61]
    best = [
        first[np.argmin(Chebyshev.between(seen, np.ones(21, dtype=bool), weights)(front))]
        for weights in ([0.95, 0.05], [0.05, 0.95])
    ]
    assert best[0] < seen[0, 0]
    assert best[1] > seen[-1, 0]


@given(COSTS, st.integers(0, 2**31))
def test_the_gradient_is_that_of_differences(costs, seed):
    k = costs.shape[1]
    weights = np.random.default_rng(seed).dirichlet(np.ones(k))
    chebyshev = Chebyshev(weights, np.zeros(k), np.full(k, 2.0))
    weighted = np.sort(weights * (costs / 2.0 + BEYOND), axis=1)
    smooth = weighted[:, -1] - weighted[:, -2] > 1e-3
    step = 1e-4 * np.eye(k)
    differences = np.column_stack(
        [(chebyshev(costs + one) - chebyshev(costs - one)) / 2e-4 for one in step]
    )
    gradient = chebyshev.gradient(costs)
    assert gradient[smooth] == pytest.approx(differences[smooth], abs=1e-6)


def test_every_point_of_a_concave_front_is_the_best_for_some_weights():
    """A weighted sum finds only the two ends of this front."""
    # Beyond, one cost gains less than ρ of what the other loses, which the sum excludes.
    angles = np.linspace(0.25, 0.5 * np.pi - 0.25, 21)
    costs = np.column_stack([np.sin(angles), np.cos(angles)])
    found = set()
    for share in np.linspace(0.0, 1.0, 1001):
        chebyshev = Chebyshev(np.array([share, 1.0 - share]), np.zeros(2), np.ones(2))
        found.add(int(np.argmin(chebyshev(costs))))
    assert found == set(range(21))


@pytest.mark.parametrize("size", [0.0, 1.0, 1.7e18, -1e60])
def test_one_point_of_any_size_has_a_scale(size):
    """Of large numbers, 1 more is the same."""
    found = Chebyshev.between(np.full((1, 2), size), np.array([True]), np.array([0.5, 0.5]))
    assert np.isfinite(found(np.full((1, 2), size))).all()
