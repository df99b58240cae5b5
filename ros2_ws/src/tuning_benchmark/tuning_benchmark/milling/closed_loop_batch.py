"""Many cuts of one controller at once: the same closed loop as plant and controller, vectorized.

A cut on the objects takes tens of milliseconds; the truth of one parameter set needs a thousand.
Here all cuts of a controller run side by side, a row for each pair of context and noise. Three
things make that possible: the filter's gain is the same in all rows, the optimum without limits is
a matrix product, and the programs of the rows share their Hessian.

The program is solved exactly, where the controller has OSQP with its tolerance. That the two agree
is tested against `MillingPlant.run_cut`.

Notation: m rows; N samples of a cut; n states of the model; H_u, H_p horizons.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import lsq_linear

from feed_axis_common.model import (
    Array,
    DiscreteModel,
    feed_axis,
    split_dead_time,
    zero_order_hold,
)
from milling_plant.cut import overshoot, reference_velocity, tracking_error
from milling_plant.settings import PlantSettings
from mpc_controller.kalman_filter import kalman_filter
from mpc_controller.qp import CondensedProgram, condense
from mpc_controller.settings import ControllerSettings

AXIS_CONSTANTS = (
    "gain",
    "damping_ratio",
    "natural_frequency",
    "stiffness_factor",
    "damping_factor",
)
"""What may differ from row to row."""

NEWTON_STEPS = 15
"""Changes of the active set after which a program is left to bounded least squares."""


@dataclass(frozen=True)
class BatchResult:
    """What the rows score.

    Attributes
    ----------
    tracking_error
        Shape (m,) [(m/s)^2]; NaN where the cut failed.
    overshoot
        Shape (m,) [m/s]; NaN where the cut failed.
    velocity
        True velocity, shape (m, N) [m/s].
    limited
        Share of the programs whose optimum the input limits changed.
    """

    tracking_error: Array
    overshoot: Array
    velocity: Array
    limited: float


class BoxProgram:
    """min 1/2 (U - V)' P (U - V) subject to lower <= U <= upper, for many V at once.

    A primal-dual active set method (Hintermueller, Ito and Kunisch 2003): from the present primal
    and dual variables guess which limits are active, solve the equations that remain, repeat. It
    ends at the exact optimum as soon as the guess repeats itself. That is not sure for every P;
    rows that go on changing are solved by bounded-variable least squares
    (Stark and Parker 1995), one by one.

    Parameters
    ----------
    P
        Positive definite, shape (H_u, H_u).
    lower, upper
        Limits of every input.
    """

    def __init__(self, P: Array, lower: float, upper: float) -> None:
        self._P = P
        self._lower = lower
        self._upper = upper
        self._responses: dict[bytes, Array] = {}

    def solve(self, V: Array) -> Array:
        """Optima (m, H_u) for the unconstrained optima V (m, H_u)."""
        U = V.copy()
        open_rows = np.arange(len(V))
        multiplier = np.zeros_like(V)
        before = np.zeros_like(V)
        for _ in range(NEWTON_STEPS):
            if open_rows.size == 0:
                return U
            trial = U[open_rows] + multiplier
            side = np.where(trial > self._upper, 1.0, np.where(trial < self._lower, -1.0, 0.0))
            changed = (side != before).any(axis=1)
            open_rows, side = open_rows[changed], side[changed]
            before = side
            U[open_rows], multiplier = self._with_active(V[open_rows], side)
        for row in open_rows:
            U[row] = self._solve_alone(V[row])
        return U

    def _with_active(self, V: Array, side: Array) -> tuple[Array, Array]:
        """Optima on the given sides (-1, 0: free, 1), and the multipliers of the limits."""
        U = np.where(side > 0, self._upper, np.where(side < 0, self._lower, V))
        active = side != 0.0
        shift = np.where(active, U - V, 0.0)
        packed = np.packbits(active, axis=1)
        if len(packed):
            keys = packed.view(np.dtype((np.void, packed.shape[1]))).ravel()
            distinct, group = np.unique(keys, return_inverse=True)
            for index, key in enumerate(distinct):
                rows = np.flatnonzero(group == index)
                shift[rows] = shift[rows] @ self._response(key.tobytes(), active[rows[0]]).T
        return V + shift, np.where(active, -shift @ self._P, 0.0)

    def _response(self, key: bytes, active: NDArray[np.bool_]) -> Array:
        """Matrix (H_u, H_u) from shifts of the active inputs to the best shifts of all."""
        if key not in self._responses:
            free = ~active
            response = np.diag(active.astype(float))
            response[np.ix_(free, active)] = -np.linalg.solve(
                self._P[np.ix_(free, free)], self._P[np.ix_(free, active)]
            )
            self._responses[key] = response
        return self._responses[key]

    def _solve_alone(self, V: Array) -> Array:
        root = np.linalg.cholesky(self._P).T
        least_squares = lsq_linear(
            root, root @ V, bounds=(self._lower, self._upper), method="bvls", tol=1e-14
        )
        solution: Array = np.asarray(least_squares.x)
        return solution


class CutBatch:
    """Cuts of one axis in given contexts with given noise, for any controller.

    Parameters
    ----------
    plant
        Axis and reference; its own context and seed do not matter for what the rows give.
    contexts
        For each of some `AXIS_CONSTANTS`, its values (m,).
    noise
        Measurement noise (m, N) [m/s].

    Raises
    ------
    ValueError
        If a context names anything else, or shapes do not agree.
    """

    def __init__(self, plant: PlantSettings, contexts: Mapping[str, Array], noise: Array) -> None:
        self._plant = plant
        self.reference = reference_velocity(plant)
        self._noise = noise
        rows = len(noise)
        for name, values in contexts.items():
            if name not in AXIS_CONSTANTS:
                raise ValueError(f"{name}: expected one of {', '.join(AXIS_CONSTANTS)}")
            if np.shape(values) != (rows,):
                raise ValueError(f"{name}: shape {np.shape(values)}; expected ({rows},)")
        if noise.shape != (rows, self.reference.size):
            raise ValueError(f"noise: shape {noise.shape}; expected (m, {self.reference.size})")
        constants = np.tile([getattr(plant, name) for name in AXIS_CONSTANTS], (rows, 1))
        for name, values in contexts.items():
            constants[:, AXIS_CONSTANTS.index(name)] = values
        self._gain = constants[:, 0]
        self._Phi, self._older, self._newer = _transitions(plant, constants)
        self._delay, _ = split_dead_time(plant.dead_time, plant.sample_time)

    def run(self, controller: ControllerSettings) -> BatchResult:
        """Run all rows with one controller.

        Raises
        ------
        ControllerError
            If the controller's program is singular.
        """
        law = _Controller(controller, self.reference)
        rows, samples = self._noise.shape
        r_0 = float(self.reference[0])
        x = np.zeros((rows, 2))
        x[:, 0] = r_0
        x_hat = np.tile(law.start, (rows, 1))
        u = np.full(rows, min(max(r_0 / controller.gain, law.lower), law.upper))
        commands = np.tile((r_0 / self._gain)[:, None], (1, samples + self._delay))
        velocity = np.empty((rows, samples))
        failed = np.zeros(rows, dtype=bool)
        limited = 0
        for k in range(samples):
            velocity[:, k] = x[:, 0]
            x_hat += np.outer(x[:, 0] + self._noise[:, k] - x_hat[:, 0], law.filter_gains[k])
            u, count = law.command(x_hat, u, k)
            limited += count
            x_hat = x_hat @ law.model.A.T + np.outer(u, law.model.B[:, 0])
            commands[:, k + self._delay] = u
            older = commands[:, k]
            newer = commands[:, k + 1] if self._delay > 0 else older
            x = np.einsum("mij,mj->mi", self._Phi, x)
            x += self._older * older[:, None] + self._newer * newer[:, None]
            diverged = ~(np.abs(x[:, 0]) <= self._plant.velocity_limit)
            if diverged.any():
                failed |= diverged
                x[diverged], x_hat[diverged], u[diverged] = 0.0, 0.0, law.lower
        window = self._plant.overshoot_window
        C = tracking_error(self.reference, velocity)
        excess = overshoot(self.reference, velocity, window)
        return BatchResult(
            tracking_error=np.where(failed, np.nan, C),
            overshoot=np.where(failed, np.nan, excess),
            velocity=velocity,
            limited=limited / (rows * samples),
        )


class _Controller:
    """Filter gains and control law of one setting, as `MpcController` has them."""

    def __init__(self, settings: ControllerSettings, reference: Array) -> None:
        s = settings
        self.model: DiscreteModel = s.model()
        self.lower, self.upper = s.input_lower, s.input_upper
        self.start = self.model.equilibrium(float(reference[0]), s.gain)
        self.filter_gains = _filter_gains(s, self.model, reference.size)
        program: CondensedProgram = condense(
            self.model, s.control_horizon, s.prediction_horizon, s.lambda_mpc
        )
        law = -program.inputs @ program.linear
        n = len(self.start)
        self._on_state, self._on_input = law[:, :n], law[:, n]
        preview = np.concatenate((reference, np.full(s.prediction_horizon, reference[-1])))
        windows = np.lib.stride_tricks.sliding_window_view(preview[1:], s.prediction_horizon)
        self._on_reference = windows @ law[:, n + 1 :].T
        self._program = BoxProgram(program.P, self.lower, self.upper)

    def command(self, x_hat: Array, last_input: Array, k: int) -> tuple[Array, int]:
        """Command (m,) [m/s] of sample k in each row, and in how many rows limits acted."""
        V = x_hat @ self._on_state.T + np.outer(last_input, self._on_input) + self._on_reference[k]
        u: Array = V[:, 0].copy()
        beyond = np.flatnonzero((V.min(axis=1) < self.lower) | (V.max(axis=1) > self.upper))
        if beyond.size:
            u[beyond] = self._program.solve(V[beyond])[:, 0]
        return np.clip(u, self.lower, self.upper), beyond.size


def _filter_gains(settings: ControllerSettings, model: DiscreteModel, samples: int) -> Array:
    """Gains (N, n) of the controller's own filter; they do not depend on the measurements."""
    s = settings
    n = model.A.shape[0]
    kf = kalman_filter(
        model, s.measurement_variance, s.lambda_kf, np.zeros(n), s.lambda_disturbance
    )
    gains = np.empty((samples, n))
    for k in range(samples):
        kf.update(0.0)
        gains[k] = kf.K[:, 0]
        kf.predict(0.0)
    return gains


def _transitions(plant: PlantSettings, constants: Array) -> tuple[Array, Array, Array]:
    """Transition matrices (m, 2, 2) of the axis over a sample, and what the two commands add.

    These are (m, 2) each: of the older command, until tau, and of the newer one after it. The
    columns of `constants` are the `AXIS_CONSTANTS`.
    """
    _, tau = split_dead_time(plant.dead_time, plant.sample_time)
    distinct, rows = np.unique(constants, axis=0, return_inverse=True)
    transitions = []
    for gain, damping_ratio, natural_frequency, stiffness_factor, damping_factor in distinct:
        A, B = feed_axis(gain, damping_ratio * damping_factor, natural_frequency * stiffness_factor)
        Phi_1, Gamma_1 = zero_order_hold(A, B, tau)
        Phi_2, Gamma_2 = zero_order_hold(A, B, plant.sample_time - tau)
        transitions.append((Phi_2 @ Phi_1, (Phi_2 @ Gamma_1)[:, 0], Gamma_2[:, 0]))
    Phi, older, newer = (np.array(column)[rows] for column in zip(*transitions, strict=True))
    return Phi, older, newer
