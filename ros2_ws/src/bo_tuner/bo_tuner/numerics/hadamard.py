"""Two-level screening designs from Hadamard matrices.

References
----------
Plackett and Burman (1946). The design of optimum multifactorial experiments. Biometrika 33.
Paley (1933). On orthogonal matrices. Journal of Mathematics and Physics 12.
Box and Hunter (1961). The 2^(k-p) fractional factorial designs, part I. Technometrics 3: foldover.
"""

import numpy as np

from bo_tuner.numerics.arrays import Array


def screening_design(factors: int, rng: np.random.Generator) -> Array:
    """Return a design of runs with all factors at one of two levels.

    Each level is in half of the runs of each factor, the columns are orthogonal, and since the
    mirror image of each run is a run, too, no effect of a factor is mixed with one of two together.
    Which factor has which column, and which of its levels is 1, is drawn: an interaction of three
    or more then adds noise to the effects, and not to that of a certain factor.

    Parameters
    ----------
    factors
        Their number k, at least 1.
    rng
        Draws columns, signs, and the order of the runs.

    Returns
    -------
    ndarray, shape (2 m, k)
        Entries -1 and 1; m > k is the order of a Hadamard matrix.
    """
    order = next(m for m in range(4, 8 * factors + 8, 4) if m > factors and _has_matrix(m))
    columns = rng.permutation(order - 1)[:factors] + 1
    half = hadamard(order)[:, columns] * rng.choice([-1.0, 1.0], size=factors)
    return rng.permutation(np.vstack([half, -half]))


def hadamard(order: int) -> Array:
    """Return a Hadamard matrix H (m, m), Hᵀ H = m I, with a first column of ones.

    Parameters
    ----------
    order
        m: 1, p + 1 with a prime p = 3 mod 4, or twice another such order.

    Raises
    ------
    ValueError
        If it is none of these.
    """
    if order == 1:
        return np.ones((1, 1))
    if _is_paley(order):
        return _paley(order - 1)
    if order % 2:
        raise ValueError(f"order: no matrix is known here for {order}")
    return np.kron(hadamard(order // 2), np.array([[1.0, 1.0], [1.0, -1.0]]))


def _has_matrix(order: int) -> bool:
    return order == 1 or _is_paley(order) or (order % 2 == 0 and _has_matrix(order // 2))


def _is_paley(order: int) -> bool:
    p = order - 1
    return p % 4 == 3 and all(p % k for k in range(2, int(p**0.5) + 1))


def _paley(p: int) -> Array:
    """Return the matrix of order p + 1 from the quadratic residues modulo p."""
    residues = {k * k % p for k in range(1, p)}
    character = np.array([0.0] + [1.0 if k in residues else -1.0 for k in range(1, p)])
    shifts = np.subtract.outer(np.arange(p), np.arange(p)) % p
    matrix = np.ones((p + 1, p + 1))
    matrix[1:, 1:] = character[shifts] - np.eye(p)
    return matrix
