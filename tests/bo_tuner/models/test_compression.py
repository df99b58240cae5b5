"""The scale on which a limited metric is modelled, by its closed forms."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import norm

from bo_tuner.models.categories import Coding
from bo_tuner.models.compression import NO_COMPRESSION, Compression
from bo_tuner.models.pooled_process import PooledProcess
from bo_tuner.models.pooled_responses import EveryContext

LIMIT = 5.0
KNOWN = np.array([1.0, 3.0, 6.0, 405.0])


@pytest.fixture(params=[1.0, -1.0], ids=["upper", "lower"])
def sign(request):
    return request.param


@pytest.fixture
def compression(sign):
    """The width is 4: the distance of 1 to the limit, and the median distance is 3."""
    return Compression.of(sign * KNOWN, sign * LIMIT, sign)


def test_up_to_the_width_beyond_the_limit_nothing_changes(compression, sign):
    values = sign * np.array([-1000.0, 1.0, LIMIT, 8.999])
    assert compression.apply(values).tolist() == values.tolist()
    assert compression.restore(values).tolist() == values.tolist()
    assert compression.restore_deviation(0.5, values).tolist() == [0.5] * 4


def test_farther_values_are_logarithmic(compression, sign):
    assert compression.apply(sign * 405.0) == pytest.approx(sign * (5 + 4 * (1 + np.log(100))))


def test_is_smooth_and_increasing(compression, sign):
    values = np.linspace(8.0, 10.0, 201)
    there = sign * compression.apply(sign * values)
    slope = np.diff(there) / np.diff(values)
    assert (slope > 0.0).all()
    assert np.abs(np.diff(slope)).max() < 0.01


def test_restores_what_it_was_applied_to(compression, sign):
    values = sign * np.array([-3.0, 5.0, 9.0, 9.5, 77.0, 405.0])
    assert compression.restore(compression.apply(values)) == pytest.approx(values)


def test_restores_a_deviation_by_the_slope(compression, sign):
    low, high = compression.apply(sign * np.array([200.0, 200.2]))
    deviation = compression.restore_deviation(abs(high - low), low)
    assert deviation == pytest.approx(0.2, rel=1e-3)


@pytest.mark.parametrize("deviation", [1e-12, 0.3, 2.0, 5.0])
@pytest.mark.parametrize("mean", [-4.0, 4.9, 8.0, 12.0, 20.0])
def test_the_mean_of_the_metric_is_that_of_an_integral(compression, sign, mean, deviation):
    wide = compression.including(sign * 1e12)
    grid = mean + deviation * np.linspace(-12.0, 12.0, 200_001)
    density = norm.pdf(grid, mean, deviation)
    expected = np.trapezoid(density * wide.restore(sign * grid), grid)
    found = wide.expectation(sign * np.array([mean]), np.array([deviation]))
    assert found == pytest.approx([expected], rel=1e-5)


def test_the_mean_without_far_values_is_the_mean(sign):
    mean, deviation = np.array([sign * 3.0, sign * 1e6]), np.array([0.1, 1e6])
    assert NO_COMPRESSION.expectation(mean, deviation).tolist() == mean.tolist()


def test_restores_nothing_beyond_the_farthest_known_value(compression, sign):
    beyond = sign * 1000.0
    assert compression.restore(beyond) == sign * 405.0
    wider = compression.including(sign * 2005.0)
    assert wider.restore(beyond) == pytest.approx(sign * 2005.0)
    assert wider.apply(beyond) == compression.apply(beyond)


def test_the_width_is_the_median_distance_if_nothing_is_within_the_limit(sign):
    assert Compression.of(sign * np.array([6.0, 15.0, 405.0]), sign * LIMIT, sign).width == 10.0


@pytest.mark.parametrize("known", [[], [5.0], [1.0, 2.0], [1.0, 9.0], [7.0, 7.0]])
def test_changes_nothing_if_no_known_value_is_far(known):
    compression = Compression.of(np.array(known), LIMIT)
    values = np.array([0.0, 1e300])
    for found in (compression, NO_COMPRESSION):
        assert found.apply(values).tolist() == found.restore(values).tolist() == values.tolist()


class TestWithRunsThatExplodeNowAndThen:
    """One run of ten is far beyond the limit 1, and all others are 0.5 below it."""

    @pytest.fixture
    def response(self, sign):
        x, c = np.repeat([[0.0], [0.5], [1.0]], 20, axis=0), np.empty((60, 0))
        y = sign * np.where(np.arange(60) % 10 == 7, 50.0, 0.5)
        compression = Compression.of(y, sign, sign)
        process = PooledProcess.fit(
            x, c, compression.apply(y), coding=Coding((0,)), rng=np.random.default_rng(0)
        )
        return EveryContext(process, sign, np.empty((1, 0)), sign=sign, scale=compression)

    def test_the_mean_exceeds_the_limit(self, response):
        x = np.array([[0.0], [0.5], [1.0]])
        assert (response.excess(x) > 0.0).all()
        assert (np.exp(response.log_probability(x)) < 0.5).all()

    def test_a_run_keeps_it_with_the_probability_of_most_runs(self, response):
        single = replace(response, deviations=0.5)
        assert (single.excess(np.array([[0.5]])) < response.excess(np.array([[0.5]]))).all()


class TestWithOneValueThatExplodes:
    """exp(16 (x - 0.5)) and a limit of 1: the largest value is 3,000 times that."""

    x = np.linspace(0.0, 1.0, 11)[:, None]

    def response(self, *, compressed):
        rng = np.random.default_rng(0)
        x, c = np.repeat(self.x, 3, axis=0), np.empty((33, 0))
        y = np.exp(16.0 * (x[:, 0] - 0.5)) * (1.0 + 0.05 * rng.standard_normal(33))
        compression = Compression.of(y, 1.0) if compressed else NO_COMPRESSION
        process = PooledProcess.fit(
            x, c, compression.apply(y), coding=Coding((0,)), rng=np.random.default_rng(0)
        )
        return EveryContext(process, 1.0, np.empty((1, 0)), scale=compression)

    def test_what_is_well_within_the_limit_is_known_to_be(self):
        inside = self.x[:5]
        assert (np.exp(self.response(compressed=True).log_probability(inside)) > 0.975).all()
        assert not (np.exp(self.response(compressed=False).log_probability(inside)) > 0.975).all()

    def test_worst_cases_and_bands_are_in_the_unit_of_the_metric(self):
        response = self.response(compressed=True)
        truth = np.exp(16.0 * (self.x[:, 0] - 0.5))
        _, worst, noise = response.worst_case(self.x)
        assert worst == pytest.approx(truth, rel=0.2, abs=0.1)
        assert 0.02 < noise[-1] / truth[-1] < 0.2
        assert response.predict_mean(self.x) == pytest.approx(worst, abs=1e-5)
        assert response.excess(self.x) == pytest.approx(worst - 1.0, abs=1e-5)
        mean, low, high = response.band(self.x, 2.0)
        assert mean == pytest.approx(worst, abs=1e-5)
        assert (low < mean).all()
        assert (mean <= high).all()
        assert high[-1] <= 3500.0
