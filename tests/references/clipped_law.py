"""The milling scenario with a linear MPC whose input is clipped, for many evaluations at once.

Written from the scenario's equations alone, on numpy: the loop of all contexts and noise draws
advances together. Numbers are those of the scenario's table, not of any configuration file.
"""

from dataclasses import dataclass

import numpy as np
from scipy.signal import cont2discrete

SAMPLE_TIME = 0.02
DAMPING, FREQUENCY = 1.0, 26.0
NOISE_VARIANCE = 0.001
LIMITS = (0.0, 1.2)
REFERENCE = np.repeat([0.50, 0.85, 0.50, 0.76, 0.50, 0.68], 45)
WINDOW = 5


@dataclass
class Evaluations:
    """Velocities and commands (N, cuts) with tracking error and overshoot of each cut."""

    velocity: np.ndarray
    command: np.ndarray
    tracking_error: np.ndarray
    overshoot: np.ndarray


def _axis(stiffness, damping):
    w, D = FREQUENCY * stiffness, DAMPING * damping
    A = np.array([[0.0, 1.0], [-w * w, -2.0 * D * w]])
    B = np.array([[0.0], [w * w]])
    F, G, *_ = cont2discrete((A, B, np.eye(2), np.zeros((2, 1))), SAMPLE_TIME)
    return F, G[:, 0]


def _first_move(control_horizon, prediction_horizon, lambda_mpc):
    """Gains of u_k = Kr r - Kx x + Ku u_{k-1}, with x = (v, v', u_{k-1})."""
    F, G = _axis(1.0, 1.0)

    def outputs(x, inputs):
        state, queued, v = x[:2], x[2], []
        for u in inputs:
            state, queued = F @ state + G * queued, u
            v.append(state[0])
        return np.array(v)

    def held(U):
        return np.concatenate((U, np.full(prediction_horizon - control_horizon, U[-1])))

    rest = np.zeros(prediction_horizon)
    free = np.column_stack([outputs(e, rest) for e in np.eye(3)])
    forced = np.column_stack([outputs(np.zeros(3), held(e)) for e in np.eye(control_horizon)])
    R = 10.0**lambda_mpc
    moves = np.diff(np.eye(control_horizon + 1), axis=0)
    on_last, on_inputs = moves[:, 0], moves[:, 1:]
    inverse = np.linalg.inv(forced.T @ forced + R * on_inputs.T @ on_inputs)
    return (
        (inverse @ forced.T)[0],
        (inverse @ forced.T @ free)[0],
        -(inverse @ on_inputs.T @ on_last)[0] * R,
    )


def simulate(parameters, stiffness, damping, noise):
    """Run one evaluation for each context and column of noise (N, evaluations) [m/s].

    `parameters` are (H_u, H_p, lambda_MPC, lambda_KF).
    """
    control_horizon, prediction_horizon, lambda_mpc, lambda_kf = parameters
    Kr, Kx, Ku = _first_move(control_horizon, prediction_horizon, lambda_mpc)
    samples, evaluations = noise.shape
    F, G = _axis(1.0, 1.0)
    contexts = [_axis(s, d) for s, d in zip(stiffness, damping, strict=True)]
    plant_F = np.array([f for f, _ in contexts])
    plant_G = np.array([g for _, g in contexts])
    Phi = np.zeros((3, 3))
    Phi[:2, :2], Phi[:2, 2] = F, G
    last = np.array([0.0, 0.0, 1.0])

    Q = 10.0**lambda_kf * np.eye(3)
    P = Q
    start = REFERENCE[0]
    x = np.tile([start, 0.0], (evaluations, 1))
    estimate = np.tile([start, 0.0, start], (evaluations, 1))
    queued = np.full(evaluations, start)
    preview = np.append(REFERENCE, np.full(prediction_horizon, REFERENCE[-1]))
    velocity, command = np.empty((samples, evaluations)), np.empty((samples, evaluations))
    for k in range(samples):
        velocity[k] = x[:, 0]
        L = P[:, 0] / (P[0, 0] + NOISE_VARIANCE)
        estimate = estimate + np.outer(x[:, 0] + noise[k] - estimate[:, 0], L)
        P = P - np.outer(L, P[0])
        r = preview[k + 1 : k + 1 + prediction_horizon]
        u = np.clip(Kr @ r - estimate @ Kx + Ku * queued, *LIMITS)
        command[k] = u
        x = np.einsum("cij,cj->ci", plant_F, x) + plant_G * queued[:, None]
        estimate = estimate @ Phi.T + np.outer(u, last)
        P = Phi @ P @ Phi.T + Q
        queued = u
    ceiling = np.array(
        [REFERENCE[max(0, k - WINDOW) : k + WINDOW + 1].max() for k in range(samples)]
    )
    return Evaluations(
        velocity,
        command,
        np.sum((REFERENCE[:, None] - velocity) ** 2, axis=0),
        np.maximum(np.max(velocity - ceiling[:, None], axis=0), 0.0),
    )


def draw_noise(rng, evaluations):
    """Measurement noise (N, evaluations) [m/s]."""
    return rng.normal(0.0, np.sqrt(NOISE_VARIANCE), (REFERENCE.size, evaluations))
