"""How far noise reaches, against the laws that it is drawn from."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import binom, expon, norm

from bo_tuner.models.categories import Coding
from bo_tuner.models.noise_shape import NoiseShape
from bo_tuner.models.pooled_process import PooledProcess
from bo_tuner.models.pooled_responses import EveryContext, OverContexts

COUNT = 4000
LEVELS = (np.arange(COUNT) + 0.5) / COUNT


def shape(residuals):
    return NoiseShape.of(residuals, np.ones(len(residuals)))


@pytest.mark.parametrize("probability", [0.9, 0.95, 0.99])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_long_tail_reaches_to_the_bound_of_its_quantile(probability, sign):
    """An exponential law less its mean has the standard deviation 1."""
    found = shape(sign * (expon.ppf(LEVELS) - 1.0)).deviations(norm.ppf(probability), sign)
    # The first of the values in order that fewer than it are below the quantile 19 times of 20.
    below = binom.ppf(0.95, COUNT, probability)
    assert found == pytest.approx(expon.ppf((below + 0.5) / COUNT) - 1.0)
    assert found > expon.ppf(probability) - 1.0


@pytest.mark.parametrize("share", [0.06, 0.1, 0.2, 0.5])
def test_two_kinds_of_runs_reach_beyond_their_quantile(share):
    """Of 60 runs of mean 0 and standard deviation 1, wherever few of a kind are among them."""
    rng, tight = np.random.default_rng(4), 0.2
    apart = np.sqrt((1.0 - tight**2) / (share * (1.0 - share)))
    quantile = (1.0 - share) * apart + tight * norm.ppf(1.0 - 0.05 / share)
    kept = [
        shape(
            apart * ((rng.random(60) < share) - share) + tight * rng.standard_normal(60)
        ).deviations(norm.ppf(0.95), 1.0)
        >= min(quantile, np.sqrt(19.0))
        for _ in range(400)
    ]
    # Runs miss the kind altogether with a probability of (1 - share)^60.
    assert np.mean(kept) > 0.95 - (1.0 - share) ** 60 - 3.0 * np.sqrt(0.95 * 0.05 / 400)


def test_it_is_left_before_too_many_are_beyond():
    """Three of 60 are far off, as many as may be beyond the normal quantile for 0.95."""
    residuals = np.concatenate([0.5 * norm.ppf((np.arange(57) + 0.5) / 57), np.full(3, 4.0)])
    assert shape(residuals).deviations(norm.ppf(0.95), 1.0) == pytest.approx(4.0)
    assert shape(residuals).deviations(norm.ppf(0.95), -1.0) == norm.ppf(0.95)


@pytest.mark.parametrize("residuals", [norm.ppf(LEVELS), np.linspace(-1.5, 1.5, 101)])
def test_it_is_never_less_than_normal(residuals):
    for probability in (0.5, 0.9, 0.95, 0.99):
        z = float(norm.ppf(probability))
        assert shape(residuals).deviations(z, 1.0) == z


@pytest.mark.parametrize(("beyond", "contradicts"), [(5, False), (8, False), (10, True)])
def test_more_of_100_residuals_than_chance_puts_there_contradict(beyond, contradicts):
    """Of 100 normal ones 10 or more exceed the quantile for 0.95 once in 35 times, 8 in 8."""
    # As many on the other side, so that they are not skewed.
    residuals = np.repeat([-3.0, 0.0, 3.0], [beyond, 100 - 2 * beyond, beyond])
    assert (shape(residuals).deviations(1.645, 1.0) > 1.645) == contradicts


@pytest.mark.parametrize("share", [0.05, 0.1, 0.2])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_rare_kind_leaves_few_degrees_of_freedom(share, sign):
    """A Bernoulli variable has the excess kurtosis (1 - 6 p q) / (p q)."""
    residuals = sign * np.where(np.arange(1000) < 1000 * share, 3.0, 0.0)
    product = share * (1.0 - share)
    kurtosis = 3.0 + (1.0 - 6.0 * product) / product
    assert shape(residuals).degrees == pytest.approx(2.0 / (kurtosis - 1.0))


@pytest.mark.parametrize("residuals", [norm.ppf(LEVELS), np.zeros(40), np.empty(0)])
def test_each_normal_residual_is_a_degree_of_freedom(residuals):
    assert shape(residuals).degrees == 1.0


def test_it_exceeds_what_no_law_can():
    """Not even if all residuals are far off, as those of a model that does not fit."""
    z = float(norm.ppf(0.95))
    assert shape(np.full(50, 1e6)).deviations(z, 1.0) == pytest.approx(np.sqrt(19.0))


def test_without_residuals_that_count_it_is_normal():
    assert NoiseShape.of(np.full(9, 5.0), np.full(9, 0.1)).deviations(2.0, 1.0) == 2.0
    assert NoiseShape.of(np.empty(0), np.empty(0)).deviations(2.0, 1.0) == 2.0
    assert shape(np.full(50, 5.0)).deviations(-1.0, 1.0) == -1.0


def test_residuals_count_as_much_as_they_are_unexplained():
    """Two of three residuals at 3, which weigh nothing, do not matter."""
    residuals = np.concatenate([norm.ppf(LEVELS), np.full(2 * COUNT, 3.0)])
    weights = np.repeat([1.0, 0.0], [COUNT, 2 * COUNT])
    found = NoiseShape.of(residuals, weights).deviations(1.0, 1.0)
    assert found == pytest.approx(1.0, abs=0.01)


class TestLimitOnRunsThatEndFarOffNowAndThen:
    """One run in ten is 1 above the others, whatever the parameter and the context."""

    X = np.linspace(0.0, 1.0, 8)

    @pytest.fixture
    def process(self):
        rng = np.random.default_rng(0)
        x, c = np.repeat(self.X, 20)[:, None], np.tile([0.0, 1.0], 80)[:, None]
        y = np.where(np.arange(160) // 2 % 10 == 7, 1.0, 0.0) + 0.05 * rng.standard_normal(160)
        return PooledProcess.fit(x, c, y, coding=Coding((0,)), rng=rng)

    @pytest.mark.parametrize(("probability", "within"), [(0.95, 1.0), (0.99, 1.0)])
    def test_the_quantile_is_that_of_the_runs_far_off(self, process, probability, within):
        z = float(norm.ppf(probability))
        limit = EveryContext(process, 2.0, np.array([[0.0], [1.0]]), z)
        found = limit.predict_mean(np.array([[0.3], [0.6]]))
        assert found == pytest.approx(within, abs=0.25)
        # A normal law of the same variance ends at 0.1 + 0.3 z.
        assert (found > 0.1 + 0.3 * z + 0.1).all() or probability == 0.99

    def test_so_is_that_over_contexts(self, process):
        over = OverContexts(process, 2.0, np.array([[0.0], [1.0]]), 0.95)
        assert over.predict_mean(np.array([[0.3]])) == pytest.approx(1.0, abs=0.25)

    def test_a_lower_limit_has_the_other_tail(self, process):
        lower = EveryContext(process, -2.0, np.array([[0.0]]), float(norm.ppf(0.95)), sign=-1.0)
        upper = replace(lower, limit=2.0, sign=1.0)
        middle = float(process.means(np.array([[0.3]]), np.array([[0.0]]))[0, 0])
        below = middle - float(lower.predict_mean(np.array([[0.3]]))[0])
        above = float(upper.predict_mean(np.array([[0.3]]))[0]) - middle
        assert below == pytest.approx(1.645 * 0.3, abs=0.05)
        assert above > 1.5 * below
