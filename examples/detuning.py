"""The classical rule with as many flights as the tuner: its gains times factors, the best of many.

What an engineer does with a rule whose gains are too high: a factor for each loop, found by flying.
The first half of the flights looks at factors from all of the range, the second improves the best
of them (J. A. Nelder and R. Mead, A simplex method for function minimization, Computer Journal 7,
1965).
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from comparison import Comparison
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.stats import qmc

HARD = 3
"""Flights of a set of gains where the default goes farthest, beside those in drawn conditions."""
SMALLEST = 0.03
"""Of the factors, which go up to 1; both searches see their logarithms."""
PENALTY = 10.0
"""Of a limit that is exceeded by all of itself, in units of the objective."""


def hardest(compare: Comparison, gains: Mapping[str, float]) -> list[int]:
    """Return the places in the grid where gains go farthest; a crash is as far as can be."""
    (metric,) = compare.limits("worst_case")
    reach = [np.inf if f.crashed else getattr(f, metric) for f in compare.fly(gains, compare.grid)]
    return [int(k) for k in np.argsort(reach)[-HARD:]]


def detune(
    rule: Callable[[Sequence[float]], Mapping[str, float]],
    loops: int,
    compare: Comparison,
    hard: Sequence[int],
    drawn: list[Any],
    flights: int,
    seed: int,
) -> Mapping[str, float] | None:
    """Return the gains with the smallest objective among those that kept all limits.

    Parameters
    ----------
    rule
        From a factor for each loop to gains.
    loops
        Number of factors.
    compare
        Flies.
    hard
        Conditions by their place in the grid, see `hardest`.
    drawn
        Conditions; not those of the judge.
    flights
        To be spent.
    seed
        Of factors and noise.

    Returns
    -------
    mapping or None
        None if no set of gains kept the limits.
    """
    rng = np.random.default_rng(seed)
    noisy = [replace(compare.grid[k], seed=100_000 * seed + k) for k in hard]
    kept: list[tuple[float, Mapping[str, float]]] = []

    def cost(exponents: NDArray[np.float64]) -> float:
        """Return the objective with a penalty; a crash is worse than any limit that is broken."""
        gains = rule(list(SMALLEST**exponents))
        flown = compare.fly(gains, drawn + noisy)
        excess = compare.excess(flown[: len(drawn)], flown[len(drawn) :])
        if not np.isfinite(excess):
            return 1e6 * sum(flight.crashed for flight in flown)
        objective = compare.mean_objective(flown[: len(drawn)])
        if excess == 0.0:
            kept.append((objective, gains))
        return objective + PENALTY * excess

    tried = flights // (len(drawn) + len(hard))
    candidates = qmc.LatinHypercube(loops, rng=rng).random(tried // 2)
    best = candidates[np.argmin([cost(exponents) for exponents in candidates])]
    minimize(
        cost, best, method="Nelder-Mead", bounds=[(0.0, 1.0)] * loops,
        options={"maxfev": tried - len(candidates)},
    )  # fmt: skip
    return min(kept, key=lambda found: found[0])[1] if kept else None
