"""The judge of parameter sets, on few contexts and draws."""

import numpy as np
import pytest

from mpc_controller.errors import ControllerError
from tuning_benchmark.milling import judge as truth
from tuning_benchmark.milling.closed_loop_batch import CutBatch
from tuning_benchmark.milling.judge import Judge

CONSTANTS = {"plant": {}, "controller": {}}
DRAWN = {
    "stiffness_factor": np.array([0.8, 0.9, 1.0, 1.1, 1.2, 1.3]),
    "damping_factor": np.array([1.0, 0.8, 1.2, 0.9, 1.1, 0.7]),
}
SIDES = np.array([0.7, 1.0, 1.3])
GRID = {"stiffness_factor": np.repeat(SIDES, 3), "damping_factor": np.tile(SIDES, 3)}
CORNERS = np.array([0, 2, 6, 8])
VALUES = {"controller": {"control_horizon": 9, "prediction_horizon": 9, "lambda_mpc": -1.0}}


@pytest.fixture(scope="module")
def judge():
    return Judge(CONSTANTS, DRAWN, GRID, CORNERS, 1)


def test_corners_bound_the_grid_from_below(judge):
    assert judge.corner_overshoot(VALUES) <= judge.grid_overshoot(VALUES).max()


def test_rough_judges_the_corners_as_corner_overshoot_does(judge):
    assert judge.rough(VALUES)[1] == pytest.approx(judge.corner_overshoot(VALUES))


def test_worst_is_the_largest_mean_over_noise_of_a_context(judge, monkeypatch):
    overshoot = np.random.default_rng(0).uniform(0.0, 0.2, (9, truth.NOISE))

    class Scored:
        def __init__(self, rows):
            self.overshoot = overshoot.ravel() if rows == overshoot.size else np.full(rows, 0.1)
            self.tracking_error = np.full(rows, 2.0)

    monkeypatch.setattr(CutBatch, "run", lambda self, controller: Scored(len(self._noise)))
    judgement = judge.judge(VALUES)
    assert judgement.objective == 2.0
    assert judgement.worst == pytest.approx(overshoot.mean(axis=1).max())
    assert judgement.worst_index == overshoot.mean(axis=1).argmax()
    assert judge.precise_worst(VALUES) == pytest.approx(0.1)


def test_a_diverged_context_is_the_worst(judge, monkeypatch):
    means = np.full(9, 0.01)
    means[4] = np.nan
    monkeypatch.setattr(judge, "grid_overshoot", lambda values: means)
    judgement = judge.judge(VALUES)
    assert np.isnan(judgement.worst)
    assert judgement.worst_index == 4


def test_a_controller_without_a_law_has_no_numbers(judge, monkeypatch):
    def singular(self, controller):
        raise ControllerError("singular")

    monkeypatch.setattr(CutBatch, "run", singular)
    judgement = judge.judge(VALUES)
    assert np.isnan([judgement.objective, judgement.worst]).all()
    assert np.isnan(judgement.single).all()


def test_equal_seeds_give_equal_judgements(judge):
    again = Judge(CONSTANTS, DRAWN, GRID, CORNERS, 1).judge(VALUES)
    assert again.objective == judge.judge(VALUES).objective
    assert Judge(CONSTANTS, DRAWN, GRID, CORNERS, 2).judge(VALUES).objective != again.objective
