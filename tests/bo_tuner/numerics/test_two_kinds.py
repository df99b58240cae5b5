"""Values of two kinds are told from those of one mode."""

import numpy as np
import pytest
from scipy import stats

from bo_tuner.numerics.two_kinds import LEVEL, RARE, gap, runs_to_see

ONE_MODE = {
    "normal": stats.norm(),
    "uniform": stats.uniform(),
    "exponential": stats.expon(),
    "gamma": stats.gamma(0.5),
    "log-normal": stats.lognorm(1.2),
    "pareto": stats.pareto(1.5),
    "student": stats.t(2),
}


@pytest.mark.parametrize("law", ONE_MODE)
def test_one_mode(law):
    """In 400 samples of any size at most as many as the level, within three standard errors."""
    rng = np.random.default_rng(11)
    samples = [ONE_MODE[law].rvs(size=8 + 3 * k % 250, random_state=rng) for k in range(400)]
    assert sum(gap(sample) is not None for sample in samples) <= 400 * LEVEL + 3.0


@pytest.mark.parametrize(("share", "size"), [(0.1, 2.0), (0.2, 1.5), (0.5, 1.3), (0.9, 2.0)])
def test_two_kinds(share, size):
    rng = np.random.default_rng(12)
    kinds = np.where(rng.random(200) < share, size, 1.0)
    between = gap(kinds * (1.0 + 0.02 * rng.standard_normal(200)))
    assert 1.1 < between < size - 0.1
    mirrored = gap(-kinds * (1.0 + 0.02 * rng.standard_normal(200)))
    assert -size + 0.1 < mirrored < -1.1


def test_the_bound_of_a_gap():
    """Five values in the upper half of [0, 1], of a law that is uniform on a tenth of it below.

    With the middle of the gap at 0.5 the four but the largest lie in (1 - 0.9) / (1 - 0.5) of it.
    """
    below, above = np.linspace(0.0, 0.1, 60), np.linspace(0.9, 1.0, 5)
    for count in (3, 4, 5):
        bound = 0.2 ** (count - 1) * count * (count + 1)
        found = gap([*below, *above[-count:]]) is not None
        assert found == (bound * (1.0 + 0.2) < LEVEL)


def test_few_equal_or_rounded_values_are_of_one_kind():
    assert gap([]) is None
    assert gap([1.0]) is None
    assert gap([1.0] * 50) is None
    assert gap([0.1, 5.0]) is None
    # Counts, whose steps are no gaps.
    assert gap(np.random.default_rng(1).poisson(4.0, 500)) is None


def test_the_runs_that_show_a_rare_kind():
    for confidence in (0.96, 0.99, 0.999):
        count = runs_to_see(confidence)
        assert (1.0 - RARE) ** count <= 1.0 - confidence < (1.0 - RARE) ** (count - 1)
