"""Points that no other one dominates."""

import numpy as np
from numpy.typing import NDArray

from bo_tuner.numerics.arrays import Array


def nondominated(costs: Array) -> NDArray[np.bool_]:
    """Return which points (n,) no other one dominates; of equal points only the first counts.

    Of their costs (n, k), smaller is better. One point dominates another if it is at least as good
    in all k costs and better in one.
    """
    at_least_as_good = (costs[:, None, :] <= costs[None, :, :]).all(axis=2)
    equal = (costs[:, None, :] == costs[None, :, :]).all(axis=2)
    earlier = np.tri(len(costs), k=-1, dtype=bool).T
    undominated: NDArray[np.bool_] = ~(at_least_as_good & (~equal | earlier)).any(axis=0)
    return undominated
