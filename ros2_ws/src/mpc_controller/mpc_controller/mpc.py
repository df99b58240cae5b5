"""Model predictive controller: the condensed program of Eq. 2, solved by OSQP."""

from dataclasses import dataclass

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
        horizon = program.P.shape[0]
        self._linear = program.linear
        self._first_input = program.inputs[0]
        self._lower = lower
        self._upper = upper
        self._solver = osqp.OSQP()
        self._solver.setup(
            P=sparse.eye(horizon, format="csc"),
            q=np.zeros(horizon),
            A=sparse.csc_matrix(program.inputs),
            l=np.full(horizon, lower),
            u=np.full(horizon, upper),
            **SOLVER_SETTINGS,
        )

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
        self._solver.update(q=q)
        result = self._solver.solve(raise_error=False)
        if result.info.status_val != osqp.SolverStatus.OSQP_SOLVED:
            return Solution(None, result.info.status, result.info.iter)
        # ADMM meets the limits only to its tolerance; the drive is never asked for more.
        u = min(max(float(self._first_input @ result.x), self._lower), self._upper)
        return Solution(u, "solved", result.info.iter)
