"""Which scale is chosen for which law, and for data that say nothing of one."""

import numpy as np
import pytest

from bo_tuner.models.categories import Coding
from bo_tuner.models.compression import Compression
from bo_tuner.models.logarithm import Logarithm
from bo_tuner.models.pooled_process import PooledProcess
from bo_tuner.models.pooled_responses import EveryContext
from bo_tuner.models.scale_choice import most_likely

COUNT = 90
POINTS = np.repeat(np.random.default_rng(1).random((COUNT // 3, 2)), 3, axis=0)
SMOOTH = np.sin(3.0 * POINTS[:, 0]) + POINTS[:, 1]
NORMAL = np.random.default_rng(2).standard_normal(COUNT)


def additive():
    return 3.0 + SMOOTH + 0.1 * NORMAL


def proportional():
    return np.exp(SMOOTH + 0.3 * NORMAL)


def test_noise_in_proportion_asks_for_the_logarithm():
    scale = most_likely(POINTS, proportional(), 6.0, 1.0)
    assert scale == Logarithm.of(proportional(), 6.0, 0.0)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_it_does_so_mirrored(sign):
    """As of a lower limit, which a search for the worst case mirrors."""
    scale = most_likely(POINTS, -proportional(), -6.0, sign)
    assert scale == Logarithm.of(-proportional(), -6.0, 0.0)


def test_noise_that_is_the_same_everywhere_asks_for_none():
    scale = most_likely(POINTS, additive(), 4.0, 1.0)
    assert scale == Compression.of(additive(), 4.0, 1.0)


@pytest.mark.parametrize("mirrored", [1.0, -1.0])
def test_noise_in_proportion_to_the_distance_from_elsewhere(mirrored):
    y = mirrored * (proportional() - 7.0)
    scale = most_likely(POINTS, y, -1.0 * mirrored, 1.0)
    assert isinstance(scale, Logarithm)
    assert (scale.width > 0.0) == (mirrored > 0.0)


@pytest.mark.parametrize(
    "y",
    [
        np.full(COUNT, 3.0),
        np.zeros(COUNT),
        np.where(np.arange(COUNT) % 2, 1.0, 2.0),
        np.where(np.arange(COUNT) == 5, 1e90, 1.0),
        np.empty(0),
        np.array([2.0]),
    ],
    ids=["all alike", "all 0", "two values", "one huge", "none", "one"],
)
@pytest.mark.parametrize("limit", [0.0, 2.0, -1e6, 1e6], ids="limit {}".format)
def test_data_that_say_nothing_of_a_scale_are_taken_as_they_are(y, limit):
    for sign in (1.0, -1.0):
        scale = most_likely(POINTS[: len(y)], y, limit, sign)
        assert scale == Compression.of(y, limit, sign)


@pytest.mark.parametrize("limit", [1e6, -1e6], ids=["above", "below"])
@pytest.mark.parametrize("values", [additive, proportional])
def test_a_limit_beyond_all_data_is_decided_by_them(values, limit):
    """All runs keep it, or none does."""
    y, c = values(), np.empty((COUNT, 0))
    scale = most_likely(POINTS, y, limit, 1.0)
    process = PooledProcess.fit(
        POINTS, c, scale.apply(y), coding=Coding((0, 0)), rng=np.random.default_rng(0)
    )
    response = EveryContext(process, limit, np.empty((1, 0)), 1.645, scale=scale)
    kept = np.exp(response.log_probability(POINTS[::3]))
    assert kept == pytest.approx(1.0 if limit > 0.0 else 0.0, abs=1e-6)
    assert np.isfinite(response.predict_mean(POINTS[::3])).all()
