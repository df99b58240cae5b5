"""Points that no other one dominates, and the hypervolume below them."""

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
    found: NDArray[np.bool_] = ~(at_least_as_good & (~equal | earlier)).any(axis=0)
    return found


def hypervolume(costs: Array, reference: Array) -> float:
    """Return the volume that points dominate, up to a reference point.

    It is cut into slices along the last cost, each as thick as the distance to the next point and
    as large as the hypervolume of the points up to there in the other costs.

    Of the costs (n, k), smaller is better. Points beyond the reference (k,) in any cost add
    nothing.
    """
    inside = costs[(costs < reference).all(axis=1)]
    if len(inside) == 0:
        return 0.0
    if costs.shape[1] == 1:
        return float(reference[0] - inside.min())
    inside = inside[np.argsort(inside[:, -1], kind="stable")]
    ends = np.append(inside[1:, -1], reference[-1])
    return float(
        sum(
            (end - row[-1]) * hypervolume(inside[: k + 1, :-1], reference[:-1])
            for k, (row, end) in enumerate(zip(inside, ends, strict=True))
            if end > row[-1]
        )
    )
