"""The feed axis of Eq. 1 in discrete time, its dead time as extra states.

Notation: A, B, C state-space matrices; x state; u input (commanded velocity [m/s]); T_s sample
time; t_d dead time; d the number of past inputs that still act.
"""

from dataclasses import dataclass
from math import ceil

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm

from feed_axis_common.errors import SettingsError

Array = NDArray[np.float64]

DEAD_TIME_TOLERANCE = 1e-9
"""A dead time this close to a multiple of the sample time, relative to it, counts as one."""

MOST_PAST_INPUTS = 100
"""Each sample time of dead time is a state."""


@dataclass(frozen=True)
class DiscreteModel:
    """x_{k+1} = A x_k + B u_k, v_k = C x_k.

    Attributes
    ----------
    A
        Shape (n, n).
    B
        Shape (n, 1).
    C
        Shape (1, n).
    axis_states
        How many leading states are the axis's own, a disturbance included; the rest are the past
        inputs u_{k-d}, ..., u_{k-1} [m/s].
    disturbance
        Index of the state that is a constant disturbance of the input [m/s], None without one.
    """

    A: Array
    B: Array
    C: Array
    axis_states: int
    disturbance: int | None = None

    def equilibrium(self, velocity: float, gain: float) -> Array:
        """State (n,) at rest on `velocity` [m/s] with the static gain `gain`."""
        x = np.full(self.A.shape[0], velocity / gain)
        x[: self.axis_states] = 0.0
        x[0] = velocity
        return x


def feed_axis(gain: float, damping_ratio: float, natural_frequency: float) -> tuple[Array, Array]:
    """Continuous-time A (2, 2) and B (2, 1) of Eq. 1 without its dead time.

    The states are the velocity v [m/s] and its rate [m/s^2]; `gain` is K [-], `damping_ratio`
    D [-] and `natural_frequency` omega_0 [rad/s].
    """
    w = natural_frequency
    A = np.array([[0.0, 1.0], [-(w**2), -2.0 * damping_ratio * w]])
    B = np.array([[0.0], [gain * w**2]])
    return A, B


def zero_order_hold(A: Array, B: Array, duration: float) -> tuple[Array, Array]:
    """Exact transition over `duration` [s] under a constant input.

    Returns e^{A t}, shape (n, n), and the integral of e^{A s} B, shape (n, m). Both come from one
    exponential of the block matrix [[A, B], [0, 0]] (Van Loan 1978).
    """
    n, m = B.shape
    block = np.zeros((n + m, n + m))
    block[:n, :n] = A
    block[:n, n:] = B
    E = expm(block * duration)
    return E[:n, :n], E[:n, n:]


def check_dead_time(dead_time: float, sample_time: float) -> None:
    """Raise `SettingsError` if a dead time [s] takes more than `MOST_PAST_INPUTS` past inputs."""
    if split_dead_time(dead_time, sample_time)[0] > MOST_PAST_INPUTS:
        raise SettingsError(
            f"dead_time: {dead_time} is above {MOST_PAST_INPUTS} sample times of {sample_time} s"
        )


def split_dead_time(dead_time: float, sample_time: float) -> tuple[int, float]:
    """Write t_d = (d - 1) T_s + tau with 0 < tau <= T_s.

    Returns d and tau [s], or (0, 0.0) without a dead time.
    """
    d = ceil(dead_time / sample_time - DEAD_TIME_TOLERANCE)
    return (d, min(dead_time - (d - 1) * sample_time, sample_time)) if d > 0 else (0, 0.0)


def delay_augmented(A: Array, B: Array, sample_time: float, dead_time: float) -> DiscreteModel:
    """Discretize a continuous system with a delayed input exactly, past inputs in the state.

    A dead time need not be a multiple of the sample time: within a sample u_{k-d} acts for tau
    seconds and u_{k-d+1} for the rest (Astrom and Wittenmark 1997, Sec. 2.3).

    Parameters
    ----------
    A, B
        Continuous-time matrices, shapes (n, n) and (n, 1).
    sample_time, dead_time
        T_s > 0 and t_d >= 0 [s].

    Returns
    -------
    DiscreteModel
        With n + d states; the output is the first state.
    """
    n = A.shape[0]
    d, tau = split_dead_time(dead_time, sample_time)
    Phi, _ = zero_order_hold(A, B, sample_time)
    transition, newer = zero_order_hold(A, B, sample_time - tau)
    A_d = np.zeros((n + d, n + d))
    B_d = np.zeros((n + d, 1))
    A_d[:n, :n] = Phi
    if d > 0:
        _, older = zero_order_hold(A, B, tau)
        A_d[:n, n : n + 1] = transition @ older
        A_d[n : n + d - 1, n + 1 :] = np.eye(d - 1)
        B_d[-1, 0] = 1.0
    if d > 1:
        A_d[:n, n + 1 : n + 2] = newer
    else:
        B_d[:n] = newer
    C = np.zeros((1, n + d))
    C[0, 0] = 1.0
    return DiscreteModel(A=A_d, B=B_d, C=C, axis_states=n)


def disturbance_augmented(model: DiscreteModel, Gamma: Array) -> DiscreteModel:
    """Let a constant disturbance be added to the input where it acts, after the dead time.

    x_{k+1} = A x_k + B u_k + Gamma d_k, d_{k+1} = d_k (Muske and Badgwell 2002; Pannocchia and
    Rawlings 2003). A load is such a disturbance, and at rest so is a wrong gain. It is the last of
    the axis's own states, and 0 in `DiscreteModel.equilibrium`.

    Parameters
    ----------
    model
        Model with n states, a of them the axis's own.
    Gamma
        What a constant input adds to the axis's states in one sample, shape (a, 1).

    Returns
    -------
    DiscreteModel
        With n + 1 states.
    """
    a = model.axis_states
    A = np.insert(np.insert(model.A, a, 0.0, axis=0), a, 0.0, axis=1)
    A[:a, a] = Gamma[:, 0]
    A[a, a] = 1.0
    return DiscreteModel(
        A=A,
        B=np.insert(model.B, a, 0.0, axis=0),
        C=np.insert(model.C, a, 0.0, axis=1),
        axis_states=a + 1,
        disturbance=a,
    )
