"""Latin hypercube samples of the unit cube (McKay, Beckman and Conover 1979)."""

import numpy as np
from numpy.typing import NDArray


def latin_hypercube(count: int, dimension: int, rng: np.random.Generator) -> NDArray[np.float64]:
    """Draw n = `count` ≥ 0 points (n, d), in each dimension one in each of n equal strata.

    The generator draws the order of the strata, then the position within each. Not SciPy's: the
    keyword for its generator has different names in the supported releases.
    """
    strata = rng.permuted(np.tile(np.arange(count), (dimension, 1)), axis=1).T
    return (strata + rng.random((count, dimension))) / max(count, 1)
