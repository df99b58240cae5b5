"""Maximization of an acquisition function whose maximum is known."""

from types import SimpleNamespace

import numpy as np
import pytest

from bo_tuner.acquisition.acquisition import Acquisition
from bo_tuner.models.compression import NO_COMPRESSION
from bo_tuner.optimizers.bayesian import AcquisitionSearch

WIDTH = 1e-3
BEST = 0.4 - WIDTH * np.log(1.0 / WIDTH)


def gap(x):
    """A slope that ends at a wall; the maximum is at (BEST, 0.7, 0.7, ...)."""
    return x[:, 0] - np.exp((x[:, 0] - 0.4) / WIDTH) - 1e4 * ((x[:, 1:] - 0.7) ** 2).sum(axis=1)


def rule(*_, **__):
    return Acquisition(gap)


def surrogates(dimension):
    """Models that know one point, beside the maximum."""
    point = np.full((1, dimension), 0.71)
    point[0, 0] = BEST - 0.01
    model = SimpleNamespace(
        points=point,
        compression=NO_COMPRESSION,
        predict=lambda x: (np.zeros(len(x)), np.ones(len(x))),
        predict_mean=lambda x: np.zeros(len(x)),
    )
    return SimpleNamespace(objective=model, log_feasibility=lambda x: np.zeros(len(x)))


@pytest.mark.parametrize("seed", range(5))
def test_it_fills_a_narrow_gap_beside_the_incumbent(make_study, seed):
    axes = {
        f"x{k}": {"node": "axis", "type": "double", "bounds": [0.0, 1.0], "default": 0.5}
        for k in range(6)
    }
    space = make_study(parameters=axes).search_space()
    rng = np.random.default_rng(seed)
    search = AcquisitionSearch(surrogates(len(axes)), space, rule, rng, narrow=True)
    found = search.maximize()
    assert found.value == pytest.approx(gap(np.array([[BEST] + [0.7] * 5]))[0], abs=1e-5)
    assert found.log_gain == found.value
