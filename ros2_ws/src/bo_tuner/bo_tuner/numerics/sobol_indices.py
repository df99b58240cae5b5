"""Variance-based sensitivity: the total index of Homma and Saltelli (1996).

The total index of an input is the share of the variance of a function that disappears only if this
input is fixed, its interactions with others included: S_Ti = 1 - V[E(y | x_~i)] / V(y). The inputs
are independent and uniform. The estimator is that of Jansen (1999), the best in the comparison of
Saltelli et al. (2010, Table 2 f), as SciPy has it.

References
----------
Homma and Saltelli (1996). Importance measures in global sensitivity analysis of nonlinear models.
Reliability Engineering and System Safety 52.
Jansen (1999). Analysis of variance designs for model output. Computer Physics Communications 117.
Saltelli et al. (2010). Variance based sensitivity analysis of model output. Computer Physics
Communications 181.
"""

from collections.abc import Callable

import numpy as np

from bo_tuner.numerics.arrays import Array

POINTS = 1024
"""Base points, a power of two as Sobol sequences need it; d + 2 times as many are evaluated."""

FLAT = 1e-12
"""Variance, relative to the mean square, below which a function counts as constant."""


def total_indices(function: Callable[[Array], Array], dimension: int) -> Array:
    """Return the total index of each input over the unit cube, shape (d,).

    Parameters
    ----------
    function
        Takes points (n, d) and returns values (n,).
    dimension
        Number of inputs d.

    Returns
    -------
    ndarray, shape (d,)
        About 0 to 1, each to some hundredths; NaN for a constant function.
    """
    # This import takes half a second, which most commands need not spend.
    from scipy.stats import qmc, sobol_indices

    both = qmc.Sobol(2 * dimension, scramble=False).random(POINTS)
    first, second = both[:, :dimension], both[:, dimension:]
    mixed = np.repeat(first[None], dimension, axis=0)
    for k in range(dimension):
        mixed[k, :, k] = second[:, k]
    f_a, f_b = function(first), function(second)
    if np.var(f_a) <= FLAT * max(float(np.mean(f_a**2)), np.finfo(float).tiny):
        return np.full(dimension, np.nan)
    f_ab = function(mixed.reshape(-1, dimension)).reshape(dimension, 1, POINTS)
    indices = sobol_indices(func={"f_A": f_a[None], "f_B": f_b[None], "f_AB": f_ab}, n=POINTS)
    totals: Array = np.asarray(indices.total_order, dtype=np.float64).ravel()
    return totals
