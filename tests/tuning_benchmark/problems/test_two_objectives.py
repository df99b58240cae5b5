"""The problem with two objectives: its front, its limit and its runs are what the text says."""

import numpy as np
import pytest
from scipy.optimize import minimize

from bo_tuner.numerics.pareto import nondominated
from tuning_benchmark.problems.two_objectives import DISTANCE, LEAN, LIMIT, Node, TwoObjectives


@pytest.fixture(params=[2, 4])
def problem(request):
    return TwoObjectives(request.param)


def test_no_point_within_the_limit_dominates_the_front(problem):
    points = np.random.default_rng(1).uniform(size=(20_000, problem.parameters))
    costs = problem.costs(points[problem.worst(points) <= LIMIT])
    for point in problem.front[::100]:
        assert not ((costs < point - 1e-12).all(axis=1)).any()
    assert nondominated(problem.front).all()


@pytest.mark.parametrize("weight", [0.2, 0.5, 0.9])
def test_a_solver_finds_points_of_the_front(problem, weight):
    """The weighted sum is convex in x, and so is the limit."""
    p, q = problem.ends

    def cost(x):
        return weight * ((x - p) ** 2).sum() + (1.0 - weight) * ((x - q) ** 2).sum()

    def left(x):
        return LIMIT - (1.0 + LEAN) * (x - p) @ (q - p) / DISTANCE**2

    found = minimize(cost, 0.5 * (p + q), constraints={"type": "ineq", "fun": left}).x
    best = (problem.front @ [weight, 1.0 - weight]).min()
    assert cost(found) == pytest.approx(best, abs=1e-6)


def test_the_means_of_runs_are_the_truth(problem):
    rng = np.random.default_rng(2)
    u = rng.uniform(0.3, 0.7, problem.parameters)
    node = Node()
    node.set_parameters({"parameters": problem.parameters, "contexts": problem.contexts})
    node.set_parameters({f"p{i + 1}": value for i, value in enumerate(u)})
    found = []
    for seed in range(4000):
        w = rng.uniform(-1.0, 1.0, problem.contexts)
        node.set_parameters({f"w{j + 1}": value for j, value in enumerate(w)} | {"seed": seed})
        said = node.run_cut()
        found.append([said["first"], said["second"], said["share"]])
    truth = [*problem.costs(u), problem.share(u)]
    errors = np.std(found, axis=0) / np.sqrt(len(found))
    assert np.mean(found, axis=0) == pytest.approx(truth, abs=4.0 * errors.max())


def test_the_worst_context_is_an_end(problem):
    points = np.random.default_rng(3).uniform(size=(50, problem.parameters))
    contexts = np.linspace(-1.0, 1.0, 21)
    means = problem.share(points)[:, None] * (1.0 + LEAN * contexts)
    assert problem.worst(points) == pytest.approx(means.max(axis=1))


def test_volumes(problem):
    assert problem.volume(np.empty((0, problem.parameters))) == 0.0
    points = np.random.default_rng(4).uniform(size=(5000, problem.parameters))
    beyond = points[problem.worst(points) > LIMIT]
    assert problem.volume(beyond) == 0.0
    assert 0.0 < problem.volume(points) < 1.0
    # The front lies in the cube, whose warped coordinates are from 0 to 1, too.
    assert all(end.min() > 0.0 and end.max() < 1.0 for end in problem.ends)
