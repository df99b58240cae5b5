"""The truth of a parametrization on small efforts, and the study that comes with the benchmarks."""

from pathlib import Path

import numpy as np
import pytest
from closed_loop_batch import CutBatch
from truth import Effort, Truth

from bo_tuner.study_file import load_study

SMALL = Effort(drawn=6, grid=3, noise=3, candidates=2, more_noise=4, real_cuts=2)
SECOND_AXIS = Path(__file__).parents[2] / "benchmarks" / "studies" / "second_axis.yaml"


@pytest.fixture(scope="module")
def benchmark_truth():
    return Truth(load_study("benchmark"), SMALL)


def defaults(study):
    return study.search_space().defaults


def test_grid_reaches_the_bounds_of_every_context(benchmark_truth):
    grid = benchmark_truth.grid_contexts
    assert len(grid) == 9
    assert len(np.unique(grid, axis=0)) == 9
    np.testing.assert_allclose(grid.min(axis=0), [0.7, 0.7])
    np.testing.assert_allclose(grid.max(axis=0), [1.3, 1.3])


def test_corners_are_those_of_the_grid(benchmark_truth):
    corners = benchmark_truth.grid_contexts[benchmark_truth.corners]
    assert {tuple(row) for row in corners.round(9)} == {
        (s, d) for s in (0.7, 1.3) for d in (0.7, 1.3)
    }


def test_corners_bound_the_grid_from_below(benchmark_truth):
    parameters = defaults(benchmark_truth.study)
    corner = benchmark_truth.corner_overshoot(parameters)
    assert corner <= benchmark_truth.grid_overshoot(parameters).max()


def test_worst_is_the_largest_mean_over_noise_of_a_context(benchmark_truth, monkeypatch):
    overshoot = np.random.default_rng(0).uniform(0.0, 0.2, (9, 3))

    class Scored:
        def __init__(self, rows):
            self.overshoot = overshoot.ravel() if rows == 27 else np.full(rows, 0.1)
            self.tracking_error = np.full(rows, 2.0)

    monkeypatch.setattr(CutBatch, "run", lambda self, controller: Scored(len(self._noise)))
    judgement = benchmark_truth.judge(defaults(benchmark_truth.study))
    assert judgement.E == 2.0
    assert judgement.worst == pytest.approx(overshoot.mean(axis=1).max())
    assert judgement.worst_precise == pytest.approx(0.1)
    expected = benchmark_truth.grid_contexts[overshoot.mean(axis=1).argmax()]
    np.testing.assert_allclose(list(judgement.worst_context.values()), expected)


def test_a_diverged_context_is_the_worst(benchmark_truth, monkeypatch):
    means = np.full(9, 0.01)
    means[4] = np.nan
    monkeypatch.setattr(benchmark_truth, "grid_overshoot", lambda parameters: means)
    monkeypatch.setattr(benchmark_truth, "_precise_overshoot", lambda parameters, context: 0.0)
    judgement = benchmark_truth.judge(defaults(benchmark_truth.study))
    assert np.isnan(judgement.worst)
    assert not judgement.worst <= benchmark_truth.limit


def test_chance_constraints_count_real_cuts(benchmark_truth):
    holds, shares = benchmark_truth.meets_chances(defaults(benchmark_truth.study))
    assert shares["real_time"] in (0.0, 0.5, 1.0)
    assert holds == (shares["real_time"] >= 0.96)


def test_second_axis_is_infeasible_by_default():
    study = load_study(SECOND_AXIS)
    assert study.search_space().dimension == 3
    truth = Truth(study, SMALL)
    assert truth.judge(defaults(study)).worst > truth.limit


def test_second_axis_has_a_feasible_region():
    truth = Truth(load_study(SECOND_AXIS), SMALL)
    parameters = {
        "control_horizon": 4,
        "prediction_horizon": 8,
        "lambda_mpc": -0.5,
        "lambda_kf": -1.0,
    }
    assert truth.grid_overshoot(parameters).max() <= truth.limit
