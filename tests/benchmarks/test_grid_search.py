"""The search on a cost in closed form instead of the closed loop."""

from concurrent.futures import ThreadPoolExecutor

import grid_search
import numpy as np
import pytest
from grid_search import GridSearch, Score, coarse_axis

from bo_tuner.study.study_file import load_study

OPTIMUM = (6, 9, -1.05, 0.4)


@pytest.fixture
def work(monkeypatch):
    def score(point):
        u, p, mpc, kf = point
        distance = abs(u - 6) + abs(p - 9) + (mpc + 1.05) ** 2 + (kf - 0.4) ** 2
        return Score(1.0 + distance if p < 14 else np.inf, 0.05)

    def rough(point):
        return score(point).cost, 0.05

    monkeypatch.setattr(grid_search, "_score", score)
    monkeypatch.setattr(grid_search, "_rough", rough)
    with ThreadPoolExecutor(1) as pool:
        yield GridSearch(load_study("full"), pool)


@pytest.mark.parametrize("start", [(2, 3, -4.0, 1.5), (12, 13, 0.5, -4.0), (1, 13, -2.0, -2.0)])
def test_refinement_finds_the_optimum(work, start):
    work.refine(start, work.cost, 0.3)
    u, p, mpc, kf = work.by_cost()[0]
    assert (u, p) == OPTIMUM[:2]
    assert abs(mpc - OPTIMUM[2]) <= 0.05
    assert abs(kf - OPTIMUM[3]) <= 0.05


def test_points_keep_bounds_and_order(work):
    work.refine((1, 1, -5.0, 2.0), work.cost, 0.5)
    for point in work.by_cost():
        assert 1 <= point[0] <= point[1] <= 25
        assert -5.0 <= point[2] <= 1.0
        assert -5.0 <= point[3] <= 2.0


@pytest.mark.parametrize(
    ("cost", "worst", "narrow"), [(1.1, 0.1, False), (1.3, 0.1, True), (1.1, 0.11, True)]
)
def test_narrow_is_a_neighbour_a_fifth_worse(work, monkeypatch, cost, worst, narrow):
    monkeypatch.setattr(grid_search, "_judge_short", lambda point: (cost, worst))
    work.scores([OPTIMUM])
    monkeypatch.setattr(work, "_known", {OPTIMUM: Score(1.0, 0.08)})
    assert work.narrow(OPTIMUM) is narrow


def test_axes_reach_both_bounds():
    study = load_study("full")
    for name in study.search_space().names:
        parameter = study.parameters[name]
        for complete in (True, False):
            axis = coarse_axis(parameter, complete)
            assert axis[0] == parameter.bounds[0]
            assert axis[-1] == parameter.bounds[1]
            assert axis == sorted(set(axis))
