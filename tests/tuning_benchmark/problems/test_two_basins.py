"""The narrow optimum beside a wide basin against a search over the cube."""

import numpy as np
import pytest
from scipy.optimize import differential_evolution, minimize

from bo_tuner.errors import StudyError
from tuning_benchmark.experiments.experiment_file import load_experiment
from tuning_benchmark.experiments.optima import optimum_of
from tuning_benchmark.judging.evaluator import Evaluator
from tuning_benchmark.judging.truth import Effort, Truth
from tuning_benchmark.problems.two_basins import TwoBasins
from tuning_benchmark.problems.warp import unwarped, warped

JUDGE = "tuning_benchmark.judging.closed_form:BasinsJudge"
PROBLEMS = [TwoBasins(parameters=2, radius=0.1), TwoBasins(parameters=3, radius=0.15)]


@pytest.mark.parametrize("problem", PROBLEMS, ids=lambda p: p.study().name)
def test_the_optimum_is_that_of_a_global_search(problem):
    found = differential_evolution(
        lambda u: float(problem.cost(u)), [(0.0, 1.0)] * problem.parameters, seed=1, popsize=40
    )
    assert found.fun == pytest.approx(problem.best, abs=1e-6)
    assert found.x == pytest.approx(problem.optimum, abs=1e-3)
    assert optimum_of({}, problem.study()).objective == problem.best


@pytest.mark.parametrize("problem", PROBLEMS, ids=lambda p: p.study().name)
def test_a_local_search_from_the_default_ends_in_the_wide_basin(problem):
    found = minimize(lambda u: float(problem.cost(u)), np.full(problem.parameters, 0.5))
    assert found.x == pytest.approx(unwarped(problem.bottoms[0]), abs=1e-3)
    assert found.fun == pytest.approx(1.0, abs=1e-6)
    points = np.random.default_rng(0).random((50_000, problem.parameters))
    assert np.mean(problem.cost(points) < 1.0) < 0.1


@pytest.mark.parametrize("problem", PROBLEMS, ids=lambda p: p.study().name)
def test_the_limit_binds_nowhere(problem):
    points = np.random.default_rng(0).random((2000, problem.parameters))
    assert max(problem.worst(u)[0] for u in points) < 0.7
    assert min(problem.kept(u) for u in points) > 0.999999
    truth = Truth(problem.study(), JUDGE, Effort(drawn=50, grid=3, real_evaluations=0))
    names = [f"p{k + 1}" for k in range(problem.parameters)]
    verdict = truth.verdict(dict(zip(names, problem.optimum, strict=True)))
    assert verdict.feasible
    assert verdict.objective == pytest.approx(problem.best)


def test_the_node_has_the_cost_as_its_mean():
    problem = PROBLEMS[0]
    evaluator = Evaluator(problem.study())
    cost = [evaluator.metrics({"p1": 0.3, "p2": 0.6}, {"w1": 0.0}, k)["cost"] for k in range(400)]
    # Within three standard errors; the cost's logarithm has the standard deviation 0.05.
    assert np.mean(cost) == pytest.approx(problem.cost(np.array([0.3, 0.6])), rel=3 * 0.05 / 20)


def test_an_experiment_names_the_problem():
    study = load_experiment("exploration").cases["basins-2"].study
    assert study == PROBLEMS[0].study()


@pytest.mark.parametrize(
    ("settings", "key"), [({"parameters": 1}, "parameters"), ({"radius": 0.0}, "radius")]
)
def test_settings_out_of_range_are_refused(settings, key):
    with pytest.raises(StudyError, match=key):
        TwoBasins(**({"parameters": 2} | settings))


def test_the_warp_is_undone():
    x = np.linspace(0.0, 1.0, 11)
    assert warped(unwarped(x)) == pytest.approx(x, abs=1e-12)
