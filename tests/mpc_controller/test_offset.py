"""At rest on a plant that is off the model: the closed form of the offset.

With L the gain of the filter in its steady state, K the static gain of the model and g K that of
the plant, the filter's equations at rest, x = (I - L C) (A x + B u) + L v with v = g K u, give the
estimate x that belongs to an input u. The input is the one that the law of the MPC,
u = k_x x + k_u u + k_r r, gives again.
"""

import re
from pathlib import Path

import numpy as np
import pytest
from dense_mpc import DenseMpc
from markdown_tables import rows_of
from scipy.linalg import solve_discrete_are
from second_order import DelayLine, matrices

from feed_axis_common.model import delay_augmented, feed_axis
from mpc_controller.controller import MpcController
from mpc_controller.return_time import (
    filter_operations,
    iteration_operations,
    program_operations,
)

REFERENCE = 0.5


def axis(s, gain, x=(0.0, 0.0), past=(0.0,)):
    """The axis with a sample of dead time for each past input, apart from the package's model."""
    system = matrices(gain, s.damping_ratio, s.natural_frequency)
    return DelayLine(system, s.sample_time, len(past), x, past)


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


def at_rest(s, share, load=0.0, samples=200):
    """Velocity and estimate [m/s] after many samples on a constant reference, without noise.

    `load` [m/s] is added to all inputs of the plant.
    """
    past = np.full(round(s.dead_time / s.sample_time), REFERENCE / (share * s.gain))
    plant = axis(s, share * s.gain, (REFERENCE, 0.0), past)
    controller = MpcController(s)
    controller.start(np.full(samples, REFERENCE))
    v = REFERENCE
    for _ in range(samples):
        step = controller.step(v)
        measured, v = v, plant.step(step.command + load)
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


def test_offsets_in_percent_that_the_documents_name(controller_settings):
    page = (Path(__file__).parents[2] / "docs" / "method.md").read_text()
    table = re.search(r"^\| λ_KF \| estimate above .*(?:\n\|.*)+", page, re.MULTILINE).group()
    told = [(float(row[0].partition(" ")[0]), *row[1:]) for row in rows_of(table)]
    assert [row[0] for row in told] == [-5.0, -3.0, -1.0]
    for lambda_kf, *in_percent in told:
        of_estimate, of_velocity = offsets(controller_settings(lambda_kf=lambda_kf), 0.9)
        assert in_percent == [f"{100 * of_estimate:.2f} %", f"{-100 * of_velocity:.1f} %"]


@pytest.mark.parametrize(("share", "load"), [(0.9, 0.0), (1.15, 0.0), (1.0, -0.1), (0.9, 0.08)])
@pytest.mark.parametrize("lambda_kf", [-5.0, -1.0, 2.0])
@pytest.mark.parametrize(("horizons", "delay"), [((15, 15), 1), ((1, 4), 1), ((8, 20), 3)])
def test_an_estimated_disturbance_leaves_no_offset(
    controller_settings, horizons, delay, lambda_kf, share, load
):
    settings = controller_settings(
        control_horizon=horizons[0],
        prediction_horizon=horizons[1],
        dead_time=0.02 * delay,
        lambda_kf=lambda_kf,
        estimate_disturbance=True,
    )
    v, estimate = at_rest(settings, share, load, samples=600)
    assert v == pytest.approx(REFERENCE, abs=2e-4)
    assert estimate == pytest.approx(v, abs=1e-6)
    # The same loop without it is off, or there would be nothing to remove.
    plain = controller_settings(**vars(settings) | {"estimate_disturbance": False})
    assert abs(at_rest(plain, share, load)[0] - REFERENCE) > 0.01


def cut(settings, gain, reference, noise=0.0):
    """Commands and velocities [m/s] of a cut along `reference`, from rest on its first value."""
    plant = axis(settings, gain, (reference[0], 0.0), (reference[0] / gain,))
    controller = MpcController(settings)
    controller.start(reference)
    rng = np.random.default_rng(0)
    commands, velocities = [], [reference[0]]
    for _ in reference:
        commands.append(controller.step(velocities[-1] + noise * rng.normal()).command)
        velocities.append(plant.step(commands[-1]))
    return np.array(commands), np.array(velocities), controller


def test_an_active_limit_is_no_disturbance(controller_settings):
    """The filter knows the inputs that were given: on the model's plant both loops are the same."""
    reference = np.repeat([0.5, 1.1, 0.5], 40)
    plain = controller_settings(input_upper=1.0)
    with_estimate = controller_settings(input_upper=1.0, estimate_disturbance=True)
    expected, *_ = cut(plain, 1.0, reference)
    commands, *_ = cut(with_estimate, 1.0, reference)
    assert np.sum(expected > 1.0 - 1e-4) > 20
    np.testing.assert_allclose(commands, expected, atol=2e-4)


def test_the_variance_of_a_disturbance_that_is_not_estimated_changes_no_bit(controller_settings):
    reference = np.repeat([0.5, 0.8], 20)
    first, *_ = cut(controller_settings(), 0.9, reference, 0.03)
    second, *_ = cut(controller_settings(lambda_disturbance=3.0), 0.9, reference, 0.03)
    np.testing.assert_array_equal(first, second)


@pytest.mark.parametrize(("estimate_disturbance", "states"), [(False, 3), (True, 4)])
def test_the_modelled_return_time_counts_the_state(
    controller_settings, estimate_disturbance, states
):
    settings = controller_settings(
        return_time="modelled",
        modelled_overhead=0.0,
        modelled_operation_time=1.0,
        estimate_disturbance=estimate_disturbance,
    )
    controller = MpcController(settings)
    operations = filter_operations(states) + program_operations(states, 15, 15)
    controller.start([0.5])
    step = controller.step(0.5)
    iterations = controller.cut_result()["mean_iterations"]
    assert step.return_time == operations + iterations * iteration_operations(15)


def test_the_result_names_the_variance_of_an_estimated_disturbance(controller_settings):
    for estimated in (False, True):
        settings = controller_settings(estimate_disturbance=estimated, lambda_disturbance=-2.5)
        *_, controller = cut(settings, 1.0, np.array([0.5, 0.6]))
        assert controller.cut_result().get("lambda_disturbance") == (-2.5 if estimated else None)
