"""The vectorized loop against the objects that it stands for, and its programs against daqp."""

import daqp
import numpy as np
import pytest

from feed_axis_common.model import delay_augmented, feed_axis
from milling_plant.cut import MillingPlant, reference_velocity
from mpc_controller.controller import MpcController
from mpc_controller.qp import condense
from tuning_benchmark.milling.closed_loop_batch import (
    AXIS_CONSTANTS,
    NEWTON_STEPS,
    BoxProgram,
    CutBatch,
)

# The controller solves by OSQP to 1e-6 of its scaled program; the differences add up in the loop.
TOLERANCE = 2e-4


def noise_of_seeds(plant, seeds):
    """Measurement noise (m, N) [m/s] as `milling_plant.cut.Cut` draws it for each seed (m,)."""
    samples = reference_velocity(plant).size
    deviation = np.sqrt(plant.noise_variance)
    return np.array([np.random.default_rng(s).normal(0.0, deviation, samples) for s in seeds])


def run_objects(plant, controller, contexts, seeds):
    """Scores and velocities of the same cuts on the objects, one by one."""
    axis, mpc = MillingPlant(plant), MpcController(controller)
    C, overshoot, velocity = [], [], []
    for row, seed in enumerate(seeds):
        values = {name: float(column[row]) for name, column in contexts.items()}
        axis.set_parameters(values | {"seed": int(seed)})
        result = axis.run_cut(mpc)
        assert result["status"] == "ok"
        C.append(result["tracking_error"])
        overshoot.append(result["overshoot"])
        velocity.append(axis.velocity)
    return np.array(C), np.array(overshoot), np.array(velocity)


def assert_same(plant, controller, contexts, seeds):
    batch = CutBatch(plant, contexts, noise_of_seeds(plant, seeds)).run(controller)
    C, overshoot, velocity = run_objects(plant, controller, contexts, seeds)
    np.testing.assert_allclose(batch.velocity, velocity, atol=TOLERANCE)
    np.testing.assert_allclose(batch.overshoot, overshoot, atol=TOLERANCE)
    np.testing.assert_allclose(batch.tracking_error, C, rtol=1e-3, atol=TOLERANCE)
    return batch


def random_case(seed):
    """Plant, controller, contexts and seeds at random; the model is off the plant."""
    rng = np.random.default_rng(seed)
    sample_time = rng.choice([0.005, 0.02, 0.04])
    axis = {
        "gain": rng.uniform(0.5, 2.0),
        "damping_ratio": rng.uniform(0.3, 1.5),
        "natural_frequency": rng.uniform(0.2, 1.0) / sample_time,
        "dead_time": rng.choice([0.0, 1.0, 1.0, rng.uniform(0.0, 3.5)]) * sample_time,
        "sample_time": sample_time,
    }
    horizon = int(rng.integers(1, 13))
    rows = 3
    contexts = {
        "stiffness_factor": rng.uniform(0.7, 1.3, rows),
        "damping_factor": rng.uniform(0.7, 1.3, rows),
        "gain": axis["gain"] * rng.uniform(0.9, 1.1, rows),
    }
    lower = rng.uniform(-0.3, 0.3)
    return (
        axis
        | {
            "reference_levels": rng.uniform(0.0, 1.0, 5).tolist(),
            "samples_per_level": int(rng.integers(5, 20)),
            "overshoot_window": int(rng.integers(0, 8)),
            "noise_variance": rng.choice([0.0, 1e-3]),
        },
        axis
        | {
            "control_horizon": horizon,
            "prediction_horizon": horizon + int(rng.integers(0, 8)),
            "lambda_mpc": rng.uniform(-3.0, 1.0),
            "lambda_kf": rng.uniform(-4.0, 2.0),
            "input_lower": lower,
            "input_upper": lower + rng.uniform(0.8, 1.5),
        },
        contexts,
        rng.integers(0, 2**31, rows),
    )


@pytest.mark.parametrize("seed", range(12))
def test_random_loops_agree_with_the_objects(plant_settings, controller_settings, seed):
    plant, controller, contexts, seeds = random_case(seed)
    assert_same(plant_settings(**plant), controller_settings(**controller), contexts, seeds)


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"control_horizon": 20, "prediction_horizon": 20, "lambda_mpc": -4.0},
        {"control_horizon": 2, "prediction_horizon": 4, "lambda_mpc": -3.9, "lambda_kf": 2.0},
        {"estimate_disturbance": True, "lambda_disturbance": -2.0},
    ],
)
def test_active_limits_agree_with_the_objects(plant_settings, controller_settings, changes):
    contexts = {
        "stiffness_factor": np.array([1.3, 0.7, 1.0, 1.3]),
        "damping_factor": np.array([0.7, 1.3, 1.0, 1.3]),
    }
    batch = assert_same(
        plant_settings(),
        controller_settings(input_upper=0.9, **changes),
        contexts,
        np.array([1, 2, 3, 4]),
    )
    assert batch.limited > 0.02


@pytest.mark.parametrize("newton_steps", [NEWTON_STEPS, 0])
@pytest.mark.parametrize("lambda_mpc", [-5.0, -2.0, 0.0])
def test_programs_agree_with_daqp(monkeypatch, lambda_mpc, newton_steps):
    # With no steps allowed every program is left to bounded least squares.
    monkeypatch.setattr("tuning_benchmark.milling.closed_loop_batch.NEWTON_STEPS", newton_steps)
    model = delay_augmented(*feed_axis(1.0, 1.0, 26.0), 0.02, 0.02)
    P = condense(model, 12, 15, lambda_mpc).P
    V = np.random.default_rng(0).normal(0.5, 1.0, (200, 12))
    found = BoxProgram(P, 0.0, 1.2).solve(V)
    for row, expected in zip(V, found, strict=True):
        limits = np.full(12, 1.2), np.zeros(12)
        solution = daqp.solve(P, -P @ row, np.zeros((0, 12)), *limits, primal_tol=1e-10)
        np.testing.assert_allclose(expected, solution[0], atol=1e-6)


def test_a_diverged_row_is_nan_and_leaves_the_others_alone(plant_settings, controller_settings):
    plant = plant_settings(velocity_limit=1.2)
    contexts = {"gain": np.array([1.0, 5.0])}
    noise = noise_of_seeds(plant, np.array([7, 7]))
    both = CutBatch(plant, contexts, noise).run(controller_settings())
    alone = CutBatch(plant, {"gain": np.array([1.0])}, noise[:1]).run(controller_settings())
    assert np.isnan(both.tracking_error[1])
    assert np.isnan(both.overshoot[1])
    assert both.tracking_error[0] == pytest.approx(alone.tracking_error[0], rel=1e-12)


def test_what_is_no_axis_constant_is_refused(plant_settings):
    plant = plant_settings()
    noise = noise_of_seeds(plant, np.array([1]))
    with pytest.raises(ValueError, match="dead_time: expected one of " + AXIS_CONSTANTS[0]):
        CutBatch(plant, {"dead_time": np.array([0.1])}, noise)
    with pytest.raises(ValueError, match=r"gain: shape \(2,\); expected \(1,\)"):
        CutBatch(plant, {"gain": np.array([1.0, 2.0])}, noise)
