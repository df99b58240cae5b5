"""Limits on means: how often one is shown that does not hold, and what bounds it."""

import math

import numpy as np
import pytest

from bo_tuner.numerics.mean_tests import Betting, NormalOrSkewed, is_mean_shown, mean_bound
from bo_tuner.numerics.sequential import log_mean_evidence
from bo_tuner.numerics.two_kinds import runs_to_see

CONFIDENCE = 0.96
"""Of the first certificate of several."""


def log_normal(sigma):
    return lambda rng, count: np.exp(sigma * rng.standard_normal(count) - 0.5 * sigma**2)


def spikes(share, size):
    """A share of runs at `size`, the others such that the mean is 1."""
    rest = (1.0 - share * size) / (1.0 - share)
    return lambda rng, count: np.where(rng.random(count) < share, size, rest)


NORMAL = {"normal": lambda rng, count: 1.0 + 0.3 * rng.standard_normal(count)}
SKEWED = {f"log-normal {s}": log_normal(s) for s in (0.5, 0.8, 1.2)}
KINDS = {
    f"{100.0 * share:g} % at {size:g} times": spikes(share, size)
    for share, size in ((0.05, 5.0), (0.05, 2.0), (0.1, 2.0), (0.2, 2.0))
}
RARE = {"1 % at thirty times": spikes(0.01, 30.0)}
LEAST = runs_to_see(0.5 * (1.0 + CONFIDENCE))
RUNS, MOST = 150, 200


def passed(law, test):
    """How many samples, looked at now and then, show that their mean of 1 is within 1."""
    rng, enough = np.random.default_rng(7), math.log(1.0 / (1.0 - CONFIDENCE))
    samples = [law(rng, MOST) for _ in range(RUNS)]
    looks = [*range(LEAST, MOST, 40), MOST]
    # Evidence at any time counts, also if later values take the mean back.
    return sum(any(test.of(sample[:n])(1.0, enough) for n in looks) for sample in samples)


class TestLevel:
    """At most the nominal 4 %, within three standard errors of so many samples."""

    most = RUNS * 0.04 + 3.0 * math.sqrt(RUNS * 0.04 * 0.96)

    @pytest.mark.parametrize("law", [*NORMAL, *SKEWED, *KINDS])
    def test_without_a_range(self, law):
        assert passed((NORMAL | SKEWED | KINDS)[law], NormalOrSkewed()) <= self.most

    @pytest.mark.parametrize("law", [*NORMAL, *SKEWED, *KINDS, *RARE])
    def test_with_a_range(self, law):
        def within(rng, count):
            """The few values beyond the range are moved to its end, which keeps the mean below."""
            return np.minimum((NORMAL | SKEWED | KINDS | RARE)[law](rng, count), 200.0)

        assert passed(within, Betting(-200.0, 200.0)) <= self.most

    def test_the_t_statistic_alone_is_wrong_of_skewed_noise(self):
        """The reason for all this."""
        rng = np.random.default_rng(7)
        enough = math.log(1.0 / (1.0 - CONFIDENCE))
        shown = [
            (log_mean_evidence(SKEWED["log-normal 1.2"](rng, MOST), 1.0)[29:] >= enough).any()
            for _ in range(RUNS)
        ]
        assert sum(shown) > 2.0 * self.most


@pytest.mark.parametrize("test", [Betting(0.0, 3.0), NormalOrSkewed()])
class TestBound:
    def test_it_is_where_the_limit_is_just_shown(self, test):
        x = np.random.default_rng(4).uniform(0.0, 1.0, 80)
        bound = mean_bound(x, CONFIDENCE, test)
        assert x.mean() < bound < 1.0
        assert is_mean_shown(x, bound + 1e-6, CONFIDENCE, test)
        assert not is_mean_shown(x, bound - 1e-6, CONFIDENCE, test)

    def test_values_without_noise(self, test):
        assert is_mean_shown([0.5] * LEAST, 1.0, CONFIDENCE, test)
        assert not is_mean_shown([1.0] * 90, 1.0, CONFIDENCE, test)

    def test_later_values_that_contradict_earlier_ones_count(self, test):
        steady, later = np.linspace(0.4, 0.6, LEAST).tolist(), np.linspace(1.0, 3.0, 60).tolist()
        assert is_mean_shown(steady, 1.0, CONFIDENCE, test)
        assert not is_mean_shown([*steady, *later], 1.0, CONFIDENCE, test)
        assert mean_bound([*steady, *later], CONFIDENCE, test) >= np.mean([*steady, *later])

    def test_none_shows_nothing(self, test):
        assert mean_bound([], CONFIDENCE, test) == math.inf
        assert not is_mean_shown([], 1.0, CONFIDENCE, test)


def test_few_values_without_a_range_bound_nothing():
    assert mean_bound([0.1, 0.2, 0.15, 0.12], CONFIDENCE, NormalOrSkewed()) == math.inf
    assert mean_bound([0.1] * (LEAST - 1), CONFIDENCE, NormalOrSkewed()) == math.inf
    assert mean_bound([0.1] * LEAST, CONFIDENCE, NormalOrSkewed()) < 0.2
    assert mean_bound([0.1, 0.2, 0.15, 0.12], CONFIDENCE, Betting(0.0, 1.0)) < 1.0


def test_skewness_widens_the_bound():
    """Beside that of the t statistic, which of normal noise is nearly the same."""
    rng = np.random.default_rng(9)
    for sigma, least, most in ((0.05, 1.0, 1.35), (1.0, 1.5, 20.0)):
        x = log_normal(sigma)(rng, LEAST)
        enough = math.log(1.0 / (1.0 - CONFIDENCE))
        bound = mean_bound(x, CONFIDENCE, NormalOrSkewed())
        grid = np.linspace(x.mean(), bound, 400)
        t_bound = next(m for m in grid if log_mean_evidence(x, m)[-1] >= enough)
        assert least <= (bound - x.mean()) / (t_bound - x.mean()) <= most


def test_the_fewest_values_are_those_at_the_end_of_the_range():
    for high in (1.5, 3.0, 20.0):
        test = Betting(0.0, high)
        fewest = test.fewest(1.0, CONFIDENCE)
        assert is_mean_shown([0.0] * fewest, 1.0, CONFIDENCE, test)
        assert not is_mean_shown([0.0] * (fewest - 1), 1.0, CONFIDENCE, test)
    assert NormalOrSkewed().fewest(1.0, CONFIDENCE) == LEAST


def test_two_kinds_bound_nothing_without_a_range():
    x = np.array([0.1, 0.101, 0.099, 0.102] * 30 + [0.3, 0.301, 0.302] * 5)
    assert mean_bound(x, CONFIDENCE, NormalOrSkewed()) == math.inf
    assert mean_bound(x, CONFIDENCE, Betting(0.0, 1.0)) < 0.3


@pytest.mark.parametrize("farthest", [-math.inf, 0.29, 0.5, 0.99])
@pytest.mark.parametrize("spread", [0.0, 1e-16, 1e-3])
def test_what_is_shown_has_a_bound_within_the_limit(farthest, spread):
    """Runs without noise beside larger ones in other contexts as well."""
    values = 0.29 + spread * np.random.default_rng(0).standard_normal(2 * LEAST)
    test = NormalOrSkewed(farthest)
    assert is_mean_shown(values, 1.0, CONFIDENCE, test)
    assert values.mean() <= mean_bound(values, CONFIDENCE, test) <= 1.0
