"""How much later one signal is than another."""

import numpy as np

from bo_tuner.numerics.arrays import Array


def lag(late: Array, early: Array, most: int) -> float:
    """Return by how many samples a signal is behind another one: where they correlate most.

    The correlation coefficient is that of the samples which both have at a lag, so that the ends
    of the signals matter as little as their levels and sizes. A parabola through the largest one
    and its neighbours gives the fraction (G. Jacovitti and G. Scarano, IEEE Trans. Signal
    Processing 41 (1993) 525-533).

    Parameters
    ----------
    late, early
        Samples (n,) at the same times, in even distances.
    most
        Largest lag that is looked for, in both directions; n > 2 (most + 1).

    Returns
    -------
    float
        The lag in samples, from -most to most; NaN if one of the signals is constant.
    """
    count = len(late)
    lags = range(-most - 1, most + 2)
    coefficients = np.array(
        [
            _coefficient(late[max(k, 0) : count + min(k, 0)], early[max(-k, 0) : count - max(k, 0)])
            for k in lags
        ]
    )
    if not np.isfinite(coefficients).all():
        return float("nan")
    # The outermost ones are neighbours only.
    best = 1 + int(np.argmax(coefficients[1:-1]))
    left, middle, right = coefficients[best - 1 : best + 2]
    bend = left - 2.0 * middle + right
    shift = 0.5 * (left - right) / bend if bend < 0.0 else 0.0
    return float(np.clip(lags[best] + shift, -most, most))


def _coefficient(a: Array, b: Array) -> float:
    """Return the correlation coefficient of samples (m,); NaN if one of them is constant."""
    a, b = a - a.mean(), b - b.mean()
    size = float(np.sqrt((a @ a) * (b @ b)))
    return float(a @ b) / size if size > 0.0 else float("nan")
