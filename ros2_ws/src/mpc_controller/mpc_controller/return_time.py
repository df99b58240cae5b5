"""Return time of one controller step: measured, computing time, or modelled from its operations.

On a shared computer a measured time has the waits for the processor in it, and a computing time
still what others do to the caches. The model makes a campaign repeatable: it counts the
multiplications and additions that a step asks for and takes a fixed time for each.
"""

from collections.abc import Sequence

import numpy as np

QUANTILES = {"p50": 0.50, "p96": 0.96, "p99": 0.99}


def filter_operations(states: int) -> int:
    """Multiply-adds of one update and one prediction with `states` states and one measurement."""
    return 2 * (4 * states**3 + 6 * states**2 + 6 * states)


def program_operations(states: int, control_horizon: int, prediction_horizon: int) -> int:
    """Multiply-adds to form the linear term of the program."""
    return 2 * control_horizon * (states + 1 + prediction_horizon)


def iteration_operations(control_horizon: int) -> int:
    """Multiply-adds of one ADMM iteration.

    The KKT system of H_u variables and H_u bounds couples them by a triangle of
    H_u (H_u + 1) / 2 entries. Its factor fills the triangle of the bounds too; one iteration
    solves forwards and backwards with it, multiplies by the constraint matrix, and updates four
    vectors.
    """
    triangle = control_horizon * (control_horizon + 1) // 2
    return 2 * (2 * 2 * triangle + 2 * triangle + 4 * 2 * control_horizon)


def quantiles(return_times: Sequence[float]) -> dict[str, float]:
    """Quantiles [s] of a cut's return times, keyed ``return_time_p50`` and so on, and the maximum.

    A quantile is the smallest observed time that at least its share of the steps does not exceed.
    """
    times = np.asarray(return_times)
    result = {
        f"return_time_{name}": float(np.quantile(times, q, method="inverted_cdf"))
        for name, q in QUANTILES.items()
    }
    return result | {"return_time_max": float(times.max())}
