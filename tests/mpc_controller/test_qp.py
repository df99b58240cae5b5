"""The condensed program: the same optimum as Eq. 2, in coordinates with an identity Hessian."""

import numpy as np
import pytest
from second_order import DelayLine, matrices

from feed_axis_common.model import delay_augmented, feed_axis
from mpc_controller.errors import ControllerError
from mpc_controller.qp import condense, prediction_matrices

SAMPLE_TIME = 0.02


def make_model(delay, gain=1.0):
    return delay_augmented(*feed_axis(gain, 0.8, 26.0), SAMPLE_TIME, delay * SAMPLE_TIME)


@pytest.mark.parametrize(("moves", "outputs"), [(1, 1), (1, 4), (3, 3), (3, 9)])
@pytest.mark.parametrize("delay", [0, 1, 3])
def test_prediction_is_the_simulation_with_the_last_input_held(moves, outputs, delay):
    model = make_model(delay)
    Phi, Theta = prediction_matrices(model, moves, outputs)
    rng = np.random.default_rng(moves)
    x, past, U = rng.normal(size=2), rng.normal(size=delay), rng.normal(size=moves)
    axis = DelayLine(matrices(1.0, 0.8, 26.0), SAMPLE_TIME, delay, x, past)
    simulated = [axis.step(U[min(i, moves - 1)]) for i in range(outputs)]
    np.testing.assert_allclose(Phi @ np.concatenate((x, past)) + Theta @ U, simulated, atol=1e-12)


@pytest.mark.parametrize("lambda_mpc", [-8.0, -3.0, 1.0])
@pytest.mark.parametrize(("moves", "outputs"), [(1, 1), (2, 6), (8, 8), (20, 25)])
def test_unconstrained_optimum_is_that_of_the_cost(moves, outputs, lambda_mpc):
    """At W = -q the gradient of the cost over U, written out here, vanishes."""
    model = make_model(1)
    program = condense(model, moves, outputs, lambda_mpc)
    rng = np.random.default_rng(outputs)
    x, last, preview = rng.normal(size=3), rng.normal(), rng.normal(size=outputs)
    U = program.inputs @ -(program.linear @ np.concatenate((x, [last], preview)))
    Phi, Theta = prediction_matrices(model, moves, outputs)
    change = np.diff(np.concatenate(([last], U)))
    penalty = 10.0**lambda_mpc * (change - np.append(change[1:], 0.0))
    error = preview - Phi @ x - Theta @ U
    scale = abs(Theta.T) @ abs(error) + abs(penalty) + 10.0**lambda_mpc
    np.testing.assert_array_less(abs(penalty - Theta.T @ error), 1e-6 * scale)


@pytest.mark.parametrize("lambda_mpc", [-8.0, -3.0, 1.0])
def test_new_coordinates_have_an_identity_hessian(lambda_mpc):
    program = condense(make_model(1), 12, 15, lambda_mpc)
    to_inputs = program.inputs
    np.testing.assert_allclose(to_inputs.T @ program.P @ to_inputs, np.eye(12), atol=1e-7)


def test_a_weight_that_leaves_the_program_singular_is_named():
    # The last inputs act only beyond the horizon, and the weight on them underflows.
    with pytest.raises(ControllerError, match=r"lambda_mpc: -400\.0 .* horizons 6 and 6"):
        condense(make_model(2), 6, 6, -400.0)
