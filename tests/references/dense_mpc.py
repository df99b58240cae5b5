"""Eq. 2 solved without this project's matrices: predicted by simulation, optimized by daqp."""

import daqp
import numpy as np


class DenseMpc:
    """The problem over U = (u_k, ..., u_{k+H_u-1}), from a function that predicts by simulation.

    `predict` maps the H_p inputs to the H_p outputs after them, from the present state.
    """

    def __init__(self, predict, control_horizon, prediction_horizon, lambda_mpc):
        self._moves = control_horizon
        held = prediction_horizon - control_horizon

        def outputs(U):
            return predict(np.concatenate((U, np.full(held, U[-1]))))

        # The prediction is affine in U: its columns are the answers to unit inputs.
        self.free = outputs(np.zeros(control_horizon))
        self.G = np.column_stack([outputs(e) - self.free for e in np.eye(control_horizon)])
        self.weight = 10.0**lambda_mpc
        self.D = np.eye(control_horizon) - np.eye(control_horizon, k=-1)
        self.P = self.G.T @ self.G + self.weight * self.D.T @ self.D

    def _linear(self, last_input, preview):
        first = np.eye(self._moves)[0]
        return -self.G.T @ (preview - self.free) - self.weight * last_input * first

    def cost(self, U, last_input, preview):
        """J of the inputs U."""
        moves = np.diff(np.concatenate(([last_input], U)))
        return np.sum((preview - self.free - self.G @ U) ** 2) + self.weight * np.sum(moves**2)

    def unconstrained(self, last_input, preview):
        """Best inputs without limits, in closed form."""
        return -np.linalg.solve(self.P, self._linear(last_input, preview))

    def constrained(self, last_input, preview, lower, upper):
        """Best inputs within the limits, by an active-set method."""
        n = self._moves
        # Scaled to a Hessian of order one, or daqp's absolute tolerances hide small weights.
        scale = np.trace(self.P) / n
        U, _, flag, _ = daqp.solve(
            self.P / scale,
            self._linear(last_input, preview) / scale,
            np.zeros((0, n)),
            np.full(n, float(upper)),
            np.full(n, float(lower)),
            np.zeros(n, dtype=np.int32),
            primal_tol=1e-12,
            dual_tol=1e-12,
        )
        assert flag == 1
        return U
