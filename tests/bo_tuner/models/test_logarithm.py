"""The logarithmic scale of a limited metric, against scipy's log-normal law."""

import numpy as np
import pytest
from scipy.stats import lognorm, norm

from bo_tuner.models.categories import Coding
from bo_tuner.models.logarithm import Logarithm
from bo_tuner.models.pooled_process import PooledProcess
from bo_tuner.models.pooled_responses import EveryContext

KNOWN = np.array([0.5, 2.0, 40.0])


@pytest.fixture(params=[3.0, -3.0], ids=["upper", "mirrored"])
def scale(request):
    return Logarithm.of(KNOWN if request.param > 0.0 else -KNOWN, request.param)


@pytest.fixture
def values(scale):
    return KNOWN if scale.limit > 0.0 else -KNOWN


def test_it_keeps_the_limit_with_the_slope_1(scale):
    assert scale.apply(scale.limit) == pytest.approx(scale.limit)
    step = 1e-6
    assert scale.apply(scale.limit + step) - scale.limit == pytest.approx(step, rel=1e-4)


def test_it_is_increasing_and_undone(scale, values):
    there = scale.apply(np.sort(values))
    assert (np.diff(there) > 0.0).all()
    assert scale.restore(scale.apply(values)) == pytest.approx(values)


def test_slopes_are_those_of_differences(scale, values):
    step = 1e-6
    slope = (scale.apply(values + step) - scale.apply(values - step)) / (2.0 * step)
    deviation = scale.restore_deviation(0.01, scale.apply(values))
    assert deviation == pytest.approx(0.01 / slope, rel=1e-4)


@pytest.mark.parametrize(("mean", "deviation"), [(1.0, 0.5), (3.0, 2.0), (4.0, 0.01)])
def test_the_mean_is_that_of_a_log_normal_law(mean, deviation):
    scale = Logarithm.of(np.array([1.0, 1e6]), 3.0)
    found = scale.expectation(np.array([mean]), np.array([deviation]))
    median = float(scale.restore(mean))
    assert found == pytest.approx(lognorm.mean(deviation / 3.0, scale=median))


def test_quantiles_are_those_of_the_metric(scale):
    levels = np.array([0.1, 0.5, 0.9])
    runs = scale.restore(2.0 + 0.5 * norm.ppf((np.arange(20_000) + 0.5) / 20_000))
    quantiles = np.quantile(runs, levels)
    assert scale.restore(2.0 + 0.5 * norm.ppf(levels)) == pytest.approx(quantiles, rel=1e-3)


def test_restores_nothing_beyond_the_farthest_known_value():
    scale = Logarithm.of(KNOWN, 3.0)
    assert scale.restore(1e6) == pytest.approx(40.0)
    assert scale.including(80.0).restore(1e6) == pytest.approx(80.0)


@pytest.mark.parametrize("value", [0.0, -2.0])
def test_values_without_a_logarithm_are_refused(value):
    with pytest.raises(ValueError, match=f"needs values above 0, found {value:g}"):
        Logarithm.of(np.array([1.0, value]), 3.0)
    with pytest.raises(ValueError, match="needs values below 0, found 2"):
        Logarithm.of(np.array([2.0]), -3.0)
    with pytest.raises(ValueError, match="needs a limit other than 0"):
        Logarithm.of(np.array([1.0]), 0.0)


@pytest.mark.parametrize("limit", [1e6, 1e-6], ids=["above", "below"])
@pytest.mark.parametrize(
    "y",
    [
        np.full(30, 3.0),
        np.where(np.arange(30) % 2, 1.0, 2.0),
        np.exp(np.linspace(-2.0, 2.0, 30)),
    ],
    ids=["all alike", "two values", "spread"],
)
def test_a_limit_beyond_all_data_is_decided_by_them(y, limit):
    """All runs keep it, or none does."""
    x = np.repeat(np.linspace(0.0, 1.0, 10), 3)[:, None]
    scale = Logarithm.of(y, limit)
    process = PooledProcess.fit(
        x, np.empty((30, 0)), scale.apply(y), coding=Coding((0,)), rng=np.random.default_rng(0)
    )
    response = EveryContext(process, limit, np.empty((1, 0)), 1.645, scale=scale)
    kept = np.exp(response.log_probability(x[::3]))
    assert kept == pytest.approx(1.0 if limit > 1.0 else 0.0, abs=1e-6)
    assert np.isfinite(response.predict_mean(x[::3])).all()


def test_a_limit_on_the_mean_is_one_on_that_of_the_metric():
    """Runs with the median 1 and the standard deviation 1 of their logarithm have the mean √e."""
    y = np.exp(norm.ppf((np.arange(200) + 0.5) / 200))
    scale = Logarithm.of(y, 1.4)
    process = PooledProcess.fit(
        np.full((200, 1), 0.5), np.empty((200, 0)), scale.apply(y), coding=Coding((0,)),
        rng=np.random.default_rng(0),
    )  # fmt: skip
    response = EveryContext(process, 1.4, np.empty((1, 0)), scale=scale)
    assert response.predict_mean(np.array([[0.5]])) == pytest.approx(np.exp(0.5), rel=0.05)
    assert np.exp(response.log_probability(np.array([[0.5]])))[0] < 0.5
