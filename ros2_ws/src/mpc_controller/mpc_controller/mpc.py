"""Model predictive controller: the condensed program of Eq. 2, solved by OSQP."""

import signal
from dataclasses import dataclass
from typing import Any

import numpy as np
import osqp
from scipy import sparse

from feed_axis_common.model import Array
from mpc_controller.qp import CondensedProgram

# Whatever depends on the clock is off, so that equal data give equal iterates on every machine:
# the step size adapts after a fixed number of iterations and no time limit is set.
SOLVER_SETTINGS = {
    "eps_abs": 1e-6,
    "eps_rel": 1e-6,
    "max_iter": 4000,
    "check_termination": 5,
    "adaptive_rho": 1,
    "adaptive_rho_interval": 25,
    "polishing": False,
    "warm_starting": True,
    "verbose": False,
}


@dataclass(frozen=True)
class Solution:
    """What the solver returned for one sample.

    Attributes
    ----------
    input
        First input u_k [m/s], or None if the solver has no usable answer.
    status
        The solver's own word for its outcome; ``solved`` if it is usable.
    iterations
        Number of ADMM iterations.
    """

    input: float | None
    status: str
    iterations: int


class Mpc:
    """Receding-horizon solver: one OSQP workspace, only its linear term changes between samples.

    Parameters
    ----------
    program
        The condensed program.
    lower, upper
        Input limits [m/s].
    """

    def __init__(self, program: CondensedProgram, lower: float, upper: float) -> None:
        self._linear = program.linear
        self._inputs = program.inputs
        self._lower = lower
        self._upper = upper
        self._set_up()

    def solve(self, x: Array, last_input: float, preview: Array) -> Solution:
        """Solve for the present sample, warm-started from the one before.

        Parameters
        ----------
        x
            State estimate (n,).
        last_input
            u_{k-1} [m/s].
        preview
            The next H_p reference values (H_p,) [m/s].
        """
        q = self._linear @ np.concatenate((x, (last_input,), preview))
        if not np.isfinite(q).all():
            # OSQP would keep NaN in its iterates, and with it fail in all samples to come.
            return Solution(None, "data not finite", 0)
        result = self._solve(q)
        while result.info.status_val == osqp.SolverStatus.OSQP_SIGINT:
            # Another thread was handed the signal. The workspace would keep this status.
            self._set_up()
            signal.raise_signal(signal.SIGINT)
            result = self._solve(q)
        if result.info.status_val != osqp.SolverStatus.OSQP_SOLVED:
            return Solution(None, result.info.status, result.info.iter)
        # ADMM meets the limits only to its tolerance; the drive is never asked for more.
        u = min(max(float(self._inputs[0] @ result.x), self._lower), self._upper)
        return Solution(u, "solved", result.info.iter)

    def _set_up(self) -> None:
        horizon = len(self._inputs)
        self._solver = osqp.OSQP()
        self._solver.setup(
            P=sparse.eye(horizon, format="csc"),
            q=np.zeros(horizon),
            A=sparse.csc_matrix(self._inputs),
            l=np.full(horizon, self._lower),
            u=np.full(horizon, self._upper),
            **SOLVER_SETTINGS,
        )

    def _solve(self, q: Array) -> Any:
        """Solve with SIGINT held back from this thread: OSQP would take it for itself."""
        before = signal.pthread_sigmask(signal.SIG_BLOCK, (signal.SIGINT,))
        try:
            self._solver.update(q=q)
            return self._solver.solve(raise_error=False)
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)
