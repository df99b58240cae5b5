"""Latin hypercube samples of the unit cube (McKay, Beckman and Conover 1979)."""

import numpy as np
from numpy.typing import NDArray


def latin_hypercube(count: int, dimension: int, rng: np.random.Generator) -> NDArray[np.float64]:
    """Draw points such that, in each dimension, one lies in each of `count` equal strata.

    Not SciPy's: the keyword for its generator has different names in the supported releases.

    Parameters
    ----------
    count : int
        Number of points, n ≥ 0.
    dimension : int
        Dimension d of the cube.
    rng : numpy.random.Generator
        Draws the order of the strata and the position within each.

    Returns
    -------
    ndarray, shape (n, d)
    """
    strata = rng.permuted(np.tile(np.arange(count), (dimension, 1)), axis=1).T
    return (strata + rng.random((count, dimension))) / max(count, 1)
