"""At rest on a plant that is off the model: the closed form of the offset.

With L the gain of the filter in its steady state, K the static gain of the model and g K that of
the plant, the filter's equations at rest, x = (I - L C) (A x + B u) + L v with v = g K u, give the
estimate x that belongs to an input u. The input is the one that the law of the MPC,
u = k_x x + k_u u + k_r r, gives again.
"""

import numpy as np
import pytest
from dense_mpc import DenseMpc
from scipy.linalg import solve_discrete_are
from second_order import DelayLine, matrices

from feed_axis_common.model import delay_augmented, feed_axis
from mpc_controller.controller import MpcController

REFERENCE = 0.5


def axis(s, gain, x=(0.0, 0.0), past=(0.0,)):
    """The axis with one sample of dead time, apart from the package's model."""
    system = matrices(gain, s.damping_ratio, s.natural_frequency)
    return DelayLine(system, s.sample_time, 1, x, past)


def law(s):
    """Gains k_x (3,), k_u and k_r of the first input without limits, on states (v, v', u_{k-1})."""

    def first_input(x, last, r):
        def predict(inputs):
            line = axis(s, s.gain, x[:2], x[2:])
            return np.array([line.step(u) for u in inputs])

        mpc = DenseMpc(predict, s.control_horizon, s.prediction_horizon, s.lambda_mpc)
        return mpc.unconstrained(last, np.full(s.prediction_horizon, r))[0]

    rest = np.zeros(3)
    return (
        np.array([first_input(x, 0.0, 0.0) for x in np.eye(3)]),
        first_input(rest, 1.0, 0.0),
        first_input(rest, 0.0, 1.0),
    )


def offsets(s, share):
    """Relative errors at rest with g = share: of the estimate from v, of v from the reference."""
    model = delay_augmented(
        *feed_axis(s.gain, s.damping_ratio, s.natural_frequency), s.sample_time, s.dead_time
    )
    A, B, C = model.A, model.B[:, 0], model.C[0]
    eye = np.eye(3)
    P = solve_discrete_are(A.T, model.C.T, 10.0**s.lambda_kf * eye, [[s.measurement_variance]])
    L = P @ C / (C @ P @ C + s.measurement_variance)
    innovation = (1.0 - C @ L) / (1.0 + C @ np.linalg.solve(eye - A, A @ L))

    filtered = eye - np.outer(L, C)
    x = np.linalg.solve(eye - filtered @ A, filtered @ B + L * share * s.gain)
    k_x, k_u, k_r = law(s)
    u = k_r / (1.0 - k_u - k_x @ x)
    return innovation * (1.0 / share - 1.0), share * s.gain * u - 1.0


def at_rest(s, share, samples=200):
    """Velocity and estimate [m/s] after many samples on a constant reference, without noise."""
    plant = axis(s, share * s.gain, (REFERENCE, 0.0), (REFERENCE / (share * s.gain),))
    controller = MpcController(s)
    controller.start(np.full(samples, REFERENCE))
    v = REFERENCE
    for _ in range(samples):
        step = controller.step(v)
        measured, v = v, plant.step(step.command)
    return measured, step.estimate


@pytest.mark.parametrize("share", [0.9, 1.15])
@pytest.mark.parametrize("lambda_kf", [-5.0, -3.0, -1.0, 2.0])
@pytest.mark.parametrize("horizons", [(15, 15), (1, 4)])
def test_a_wrong_gain_leaves_the_offset_of_the_closed_form(
    controller_settings, horizons, lambda_kf, share
):
    settings = controller_settings(
        control_horizon=horizons[0], prediction_horizon=horizons[1], lambda_kf=lambda_kf
    )
    of_estimate, of_velocity = offsets(settings, share)
    v, estimate = at_rest(settings, share)
    # The solver's tolerance, as a share of the velocity.
    assert v / REFERENCE - 1.0 == pytest.approx(of_velocity, abs=5e-4)
    assert estimate / v - 1.0 == pytest.approx(of_estimate, abs=1e-6)


@pytest.mark.parametrize(
    ("lambda_kf", "of_estimate", "of_velocity"),
    [(-5.0, "10.00", "-9.6"), (-3.0, "1.54", "-5.9"), (-1.0, "0.02", "-5.1")],
)
def test_offsets_in_percent_that_the_documents_name(
    controller_settings, lambda_kf, of_estimate, of_velocity
):
    found = offsets(controller_settings(lambda_kf=lambda_kf), 0.9)
    assert f"{100 * found[0]:.2f}" == of_estimate
    assert f"{100 * found[1]:.1f}" == of_velocity
