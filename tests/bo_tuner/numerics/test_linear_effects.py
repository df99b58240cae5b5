"""The F test of a factor and its power, against SciPy, closed forms and simulation."""

import numpy as np
import pytest
from scipy import stats

from bo_tuner.numerics.linear_effects import POWER, linear_effect, noncentrality


def groups(counts):
    """The columns of a factor with groups, of which the first is the base."""
    return np.repeat(np.eye(len(counts)), counts, axis=0)[:, 1:]


def by_groups(y, counts, level=0.05):
    ones, others = np.ones((len(y), 1)), len(counts) - 1
    return linear_effect(y, ones, groups(counts), np.eye(others), level)


def test_groups_are_compared_as_in_the_analysis_of_variance():
    y, counts = np.random.default_rng(0).normal(size=12), [5, 4, 3]
    parts = np.split(y, np.cumsum(counts)[:-1])
    found = by_groups(y, counts)
    assert found.p_value == pytest.approx(stats.f_oneway(*parts).pvalue)
    changes = [part.mean() - parts[0].mean() for part in parts[1:]]
    assert found.change == pytest.approx(max(changes, key=abs))
    assert found.contrast == int(np.argmax(np.abs(changes)))
    pooled = sum(((part - part.mean()) ** 2).sum() for part in parts) / 9
    assert found.noise == pytest.approx(np.sqrt(pooled))


def test_a_slope_is_tested_as_in_a_regression():
    rng = np.random.default_rng(1)
    x, y = rng.random(10), rng.normal(size=10)
    line = stats.linregress(x, y)
    found = linear_effect(y, np.ones((10, 1)), x[:, None], np.array([[2.0]]), 0.05)
    assert found.p_value == pytest.approx(line.pvalue)
    assert found.change == pytest.approx(2.0 * line.slope)


@pytest.mark.parametrize(("degrees", "level"), [(2, 0.05), (4, 0.05), (9, 0.004), (60, 0.001)])
def test_the_power_for_one_column_is_that_of_the_t_test(degrees, level):
    critical = stats.t.isf(level / 2, degrees)
    shift = np.sqrt(noncentrality(1, degrees, level))
    power = stats.nct.sf(critical, degrees, shift) + stats.nct.cdf(-critical, degrees, shift)
    assert power == pytest.approx(POWER, abs=1e-6)


def test_with_many_runs_the_smallest_effect_is_the_textbooks():
    """Of two groups of n runs: σ sqrt(2 / n) (z_{1 - α/2} + z_power)."""
    n = 20_000
    y = np.random.default_rng(2).normal(scale=3.0, size=2 * n)
    expected = 3.0 * np.sqrt(2.0 / n) * (stats.norm.isf(0.025) + stats.norm.ppf(POWER))
    assert by_groups(y, [n, n]).visible == pytest.approx(expected, rel=0.02)


@pytest.mark.slow
@pytest.mark.parametrize(
    "shape",
    # Both values are compared with the same base, so that the least visible effect is one with a
    # fifth of it at the other value: 1/8 of 1/8 + 1/2, the covariance and the variance of both.
    [[1.0, 0.0], [1.0, 0.2], [1.0, 1.0], [1.0, -1.0]],
)
def test_an_effect_of_the_smallest_size_is_seen_with_the_power_at_least(shape):
    """Also if another value moves, too; the least visible of these shapes attains it."""
    rng, counts, level, runs = np.random.default_rng(3), [8, 2, 2], 0.01, 4000
    factor = groups(counts)
    spread = np.sqrt(1.0 / 8 + 1.0 / 2)
    visible = spread * np.sqrt(noncentrality(2, 9, level))
    effect = factor @ (visible * np.array(shape))
    seen = 0
    for _ in range(runs):
        found = by_groups(effect + rng.normal(size=12), counts, level)
        seen += found.p_value < level
    assert seen / runs >= POWER - 0.02
    if shape == [1.0, 0.2]:
        assert seen / runs <= POWER + 0.02


def test_the_smallest_effect_belongs_to_the_noise():
    """By its definition: the spread of the contrast, the noise, and the noncentrality."""
    y = np.random.default_rng(4).normal(size=12)
    found = by_groups(y, [8, 2, 2], 0.01)
    expected = found.noise * np.sqrt((1.0 / 8 + 1.0 / 2) * noncentrality(2, 9, 0.01))
    assert found.visible == pytest.approx(expected)


def test_what_does_nothing_is_seen_as_often_as_the_level_says():
    rng, runs = np.random.default_rng(5), 4000
    hits = sum(by_groups(rng.normal(size=12), [8, 2, 2]).p_value < 0.05 for _ in range(runs))
    assert hits / runs == pytest.approx(0.05, abs=3 * np.sqrt(0.05 * 0.95 / runs))


def test_without_noise_any_effect_is_seen():
    found = by_groups(np.array([2.0, 2.0, 2.0, 2.0, 2.1, 2.1]), [2, 2, 2])
    assert (found.p_value, found.visible, found.noise) == (0.0, 0.0, 0.0)
    assert (found.change, found.contrast) == (pytest.approx(0.1), 1)
    same = by_groups(np.full(6, 1e6) + np.array([0, 1e-7, 0, 0, 0, 0]), [2, 2, 2])
    assert (same.p_value, same.visible) == (1.0, 0.0), "rounding is no effect"


def test_data_that_cannot_tell():
    """No degrees of freedom are left, or the factor never changes."""
    assert by_groups(np.array([1.0, 2.0]), [1, 1]).visible == np.inf
    y, ones = np.array([1.0, 2.0, 3.0]), np.ones((3, 1))
    never = linear_effect(y, ones, np.full((3, 1), 0.4), np.ones((1, 1)), 0.05)
    assert (never.p_value, never.visible) == (1.0, np.inf)


def test_a_contrast_that_the_data_do_not_hold():
    """Of two columns that are always alike only the sum is known."""
    rng = np.random.default_rng(6)
    x, y, ones = rng.random(9), rng.normal(size=9), np.ones((9, 1))
    both = np.stack([x, x], axis=1)
    one, alone = (
        linear_effect(y, ones, factor, np.array(contrast), 0.05)
        for factor, contrast in ((both, [[1.0, 1.0]]), (x[:, None], [[1.0]]))
    )
    assert one.p_value == pytest.approx(alone.p_value)
    assert one.visible == pytest.approx(alone.visible)
    assert linear_effect(y, ones, both, np.array([[1.0, 0.0]]), 0.05).visible == np.inf
