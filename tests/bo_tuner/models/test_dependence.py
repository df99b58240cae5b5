"""Which coordinates a response depends on, by points that an optimizer has chosen."""

import numpy as np
import pytest
from threadpoolctl import threadpool_limits

from bo_tuner.models.categories import Coding
from bo_tuner.models.dependence import dependences
from bo_tuner.numerics.latin_hypercube import latin_hypercube

SEEDS = 40


@pytest.fixture(autouse=True)
def one_thread():
    with threadpool_limits(1):
        yield


def chosen(function, count, rng, *, noise, dimension=4, first=8):
    """Points around the best one so far, in all coordinates, and their responses."""
    points = list(latin_hypercube(first, dimension, rng))
    values = [function(x) + noise * rng.normal() for x in points]
    while len(points) < count:
        near = points[int(np.argmin(values))] + 0.15 * rng.normal(size=dimension)
        points.append(np.clip(near, 0.0, 1.0) if rng.random() < 0.85 else rng.random(dimension))
        values.append(function(points[-1]) + noise * rng.normal())
    return np.array(points), np.array(values)


def bowl(x):
    """The last two coordinates do nothing."""
    return 4.0 * (x[0] - 0.3) ** 2 + 2.0 * (x[1] - 0.6) ** 2 + x[0] * x[1]


def steep(x):
    return np.exp(6.0 * x[0])


@pytest.mark.parametrize(
    ("function", "count", "noise", "live"),
    [(bowl, 30, 0.02, (0, 1)), (bowl, 20, 0.3, ()), (steep, 30, 0.3, (0,)), (np.ndim, 20, 0.1, ())],
)
def test_false_alarms_and_what_is_seen(function, count, noise, live):
    """At the level of 5 % for each coordinate; what does something clearly is always seen."""
    # benchmarks/parameter_effects.py counts them in more runs.
    level, hits = 0.05, np.zeros(4)
    for seed in range(SEEDS):
        rng = np.random.default_rng([seed, count])
        points, values = chosen(function, count, rng, noise=noise)
        found = dependences(points, values, Coding((0,) * 4), 4, level, rng)
        hits += [effect.p_value < level for effect in found]
    dead = hits[2:].sum() / (2 * SEEDS)
    assert dead <= level + 3.0 * np.sqrt(level * (1.0 - level) / (2 * SEEDS))
    assert (hits[list(live)] >= 0.95 * SEEDS).all()


@pytest.mark.slow
def test_an_effect_of_the_smallest_size_is_seen():
    """A slope as large as what was visible without it, in the same points and noise of its own."""
    level, seen, sizes = 0.05, 0, []
    for seed in range(SEEDS):
        rng = np.random.default_rng(seed)
        points, values = chosen(bowl, 40, rng, noise=0.2)
        visible = dependences(points, values, Coding((0,) * 4), 4, level, rng)[3].visible
        sizes.append(visible)
        again = np.array([bowl(x) for x in points]) + 0.2 * rng.normal(size=40)
        found = dependences(points, again + visible * points[:, 3], Coding((0,) * 4), 4, level, rng)
        seen += found[3].p_value < level
    assert seen / SEEDS >= 0.87
    # Of what a design of two halves would tell: σ / sqrt(n / 4) times 3.3.
    assert np.median(sizes) >= 3.2 * 0.2 * 2.0 / np.sqrt(40)


def test_a_choice_and_what_else_varies():
    """A third column is no parameter, but is to be taken account of."""
    rng = np.random.default_rng(0)
    points = np.column_stack([rng.integers(3, size=40) / 2.0, rng.random(40), rng.random(40)])
    values = np.array([0.0, 1.0, 0.0])[np.rint(2.0 * points[:, 0]).astype(int)]
    values = values + 5.0 * points[:, 2] + 0.05 * rng.normal(size=40)
    law, gain = dependences(points, values, Coding((3, 0)), 2, 0.05, rng)
    assert law.p_value < 1e-6
    assert abs(law.change) == pytest.approx(1.0, abs=0.2)
    assert gain.p_value > 0.05
    assert gain.visible < 0.5, "the other column is no noise"


def test_a_single_parameter_with_two_values():
    rng = np.random.default_rng(1)
    points = rng.integers(2, size=(20, 1)).astype(float)
    values = 0.5 * points[:, 0] + 0.01 * rng.normal(size=20)
    (found,) = dependences(points, values, Coding((0,)), 1, 0.05, rng)
    assert found.p_value < 1e-6
    assert found.change == pytest.approx(0.5, abs=0.05)
