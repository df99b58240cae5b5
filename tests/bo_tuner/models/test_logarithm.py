"""The logarithmic scale of a limited metric, against scipy's log-normal law."""

import numpy as np
import pytest
from scipy.stats import lognorm, norm

from bo_tuner.models.logarithm import Logarithm

KNOWN = np.array([0.5, 2.0, 40.0])


@pytest.fixture(params=[(3.0, 0.0), (3.0, -1.0), (-3.0, 0.0), (3.0, 50.0)], ids=str)
def scale(request):
    limit, origin = request.param
    return Logarithm.of(KNOWN if limit > 0.0 else -KNOWN, limit, origin)


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
    assert np.exp(scale.log_slopes(values)) == pytest.approx(slope, rel=1e-4)
    deviation = scale.restore_deviation(0.01, scale.apply(values))
    assert deviation == pytest.approx(0.01 / slope, rel=1e-4)


@pytest.mark.parametrize(("mean", "deviation"), [(1.0, 0.5), (3.0, 2.0), (4.0, 0.01)])
def test_the_mean_is_that_of_a_log_normal_law(mean, deviation):
    scale = Logarithm.of(np.array([1.0, 1e6]), 3.0, 0.0)
    found = scale.expectation(np.array([mean]), np.array([deviation]))
    median = float(scale.restore(mean))
    assert found == pytest.approx(lognorm.mean(deviation / 3.0, scale=median))


@pytest.mark.parametrize("origin", [-1.0, 50.0])
def test_quantiles_are_those_of_the_metric(origin):
    scale = Logarithm.of(KNOWN, 3.0, origin)
    levels = np.array([0.1, 0.5, 0.9])
    runs = scale.restore(2.0 + 0.5 * norm.ppf((np.arange(20_000) + 0.5) / 20_000))
    quantiles = np.quantile(runs, levels)
    assert scale.restore(2.0 + 0.5 * norm.ppf(levels)) == pytest.approx(quantiles, rel=1e-3)


def test_restores_nothing_beyond_the_farthest_known_value():
    scale = Logarithm.of(KNOWN, 3.0, 0.0)
    assert scale.restore(1e6) == pytest.approx(40.0)
    assert scale.including(80.0).restore(1e6) == pytest.approx(80.0)


def test_a_value_beyond_the_origin_counts_as_a_small_one():
    scale = Logarithm.of(KNOWN, 3.0, 0.0).including(-7.0)
    assert np.isfinite(scale.apply(np.array([-7.0, 0.0, 1.0]))).all()
    assert scale.apply(-7.0) < scale.apply(0.5)


@pytest.mark.parametrize("value", [0.0, -2.0])
def test_values_at_or_beyond_the_origin_are_refused(value):
    with pytest.raises(ValueError, match=f"needs values above 0, found {value:g}"):
        Logarithm.of(np.array([1.0, value]), 3.0, 0.0)
    with pytest.raises(ValueError, match="needs a limit other than 0"):
        Logarithm.of(np.array([1.0]), 0.0, 0.0)
