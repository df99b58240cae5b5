"""Data over parameter set and context, and a process that is fitted to them."""

import numpy as np

from bo_tuner.models.categories import Coding
from bo_tuner.models.pooled_process import PooledProcess

PLAIN = Coding((0,))
CORNERS = np.array([[0.0], [0.5], [1.0]])


def scattered(count, seed=0, sd=lambda c: 0.01):
    """Values of x + c² with noise, at random points and, every third, at ones seen before."""
    rng = np.random.default_rng(seed)
    x, c = rng.random((count, 1)), rng.random((count, 1))
    again = np.arange(2, count, 3)
    x[again], c[again] = x[again - 1], c[again - 1]
    y = x[:, 0] + c[:, 0] ** 2 + np.vectorize(sd)(c[:, 0]) * rng.standard_normal(count)
    return x, c, y


def fitted(x, c, y, coding=PLAIN):
    return PooledProcess.fit(x, c, y, coding=coding, rng=np.random.default_rng(0))
