"""The MPC problem of Eq. 2 as a condensed quadratic program.

Over the inputs U = (u_k, ..., u_{k+H_u-1}), held constant after the last one, with x the state
estimate, r the next H_p reference values and u_{k-1} the last command:

    J = ||r - Phi x - Theta U||^2 + 10^lambda ||D U - e_1 u_{k-1}||^2,    lower <= U <= upper.

ADMM converges fast only on well-conditioned problems, and P = Theta' Theta + 10^lambda D' D is
not: its condition number passes 10^6 within the usual search range. The program is therefore posed
in W = L' U, with P = L L', so that its Hessian is the identity and the bounded inputs are L^-T W.
J is first divided by the mean eigenvalue of P: where the inputs hardly act within the horizon, as
with H_p no longer than the dead time, J is as small as its weight, and the solver's absolute
tolerance would let the input drift. The optimum is the same.
"""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import cholesky, solve_triangular

from feed_axis_common.model import Array, DiscreteModel
from mpc_controller.errors import ControllerError


@dataclass(frozen=True)
class CondensedProgram:
    """min 1/2 W'W + q'W subject to lower <= inputs W <= upper, with q = linear (x, u_{k-1}, r).

    Attributes
    ----------
    P
        Hessian of J / 2 over U, scaled to a mean eigenvalue of 1; shape (H_u, H_u).
    linear
        Maps the stacked (x, u_{k-1}, r), shape (n + 1 + H_p,), onto q: shape (H_u, n + 1 + H_p).
    inputs
        Maps W onto U: L^-T, shape (H_u, H_u), upper triangular.
    """

    P: Array
    linear: Array
    inputs: Array


def prediction_matrices(
    model: DiscreteModel, control_horizon: int, prediction_horizon: int
) -> tuple[Array, Array]:
    """Phi (H_p, n) and Theta (H_p, H_u): v_{k+1}, ..., v_{k+H_p} are Phi x + Theta U."""
    steps = np.arange(prediction_horizon)
    Phi = np.zeros((prediction_horizon, model.A.shape[0]))
    impulse = np.zeros(prediction_horizon)
    row = model.C
    for j in steps:
        impulse[j] = (row @ model.B).item()
        row = row @ model.A
        Phi[j] = row[0]
    lag = steps[:, None] - steps[None, :]
    response = np.where(lag >= 0, impulse[np.maximum(lag, 0)], 0.0)
    hold_last = np.eye(control_horizon)[np.minimum(steps, control_horizon - 1)]
    return Phi, response @ hold_last


def condense(
    model: DiscreteModel, control_horizon: int, prediction_horizon: int, lambda_mpc: float
) -> CondensedProgram:
    """Build the program of Eq. 2 with Q = I and R = I 10^lambda_mpc.

    The horizons are in samples, H_p >= H_u >= 1.

    Raises
    ------
    ControllerError
        If the weight is so small that the Hessian is not positive definite in floating point.
    """
    Phi, Theta = prediction_matrices(model, control_horizon, prediction_horizon)
    R = 10.0**lambda_mpc
    D = np.eye(control_horizon) - np.eye(control_horizon, k=-1)
    P = Theta.T @ Theta + R * (D.T @ D)
    scale = np.trace(P) / control_horizon
    P = P / scale
    try:
        L = cholesky(P, lower=True)
    except np.linalg.LinAlgError:
        raise ControllerError(
            f"lambda_mpc: {lambda_mpc} leaves the program singular with horizons "
            f"{control_horizon} and {prediction_horizon}; expected a larger weight on input moves"
        ) from None
    on_last_input = np.zeros((control_horizon, 1))
    on_last_input[0] = -R
    linear = np.hstack([Theta.T @ Phi, on_last_input, -Theta.T]) / scale
    return CondensedProgram(
        P=P,
        linear=solve_triangular(L, linear, lower=True),
        inputs=solve_triangular(L.T, np.eye(control_horizon), lower=False),
    )
