"""The problem with two objectives: its front, its limit and its runs are what the text says."""

from itertools import chain, combinations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.optimize import minimize

from bo_tuner.numerics.pareto import nondominated
from tuning_benchmark.problems.two_objectives import (
    DISTANCE,
    LEAN,
    LIMIT,
    Node,
    TwoObjectives,
    hypervolume,
)


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
        said = node.evaluate()
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


def by_inclusion_and_exclusion(costs, reference):
    """Area of a union of boxes: those of all subsets, with alternating signs."""
    boxes = [row for row in costs if (row < reference).all()]
    subsets = chain.from_iterable(combinations(boxes, n) for n in range(1, len(boxes) + 1))
    return sum(
        (-1) ** (len(subset) + 1) * np.prod(reference - np.max(subset, axis=0))
        for subset in subsets
    )


# A coarse grid, so that ties are frequent.
@given(arrays(np.float64, st.tuples(st.integers(1, 7), st.just(2)), elements=st.integers(0, 5)))
def test_hypervolume_is_that_of_the_union_of_boxes(costs):
    reference = np.full(2, 4.5)
    expected = by_inclusion_and_exclusion(costs, reference)
    assert hypervolume(costs, reference) == pytest.approx(expected)
    assert hypervolume(costs[nondominated(costs)], reference) == pytest.approx(expected)


def test_hypervolume_of_a_quarter_of_a_disc():
    angles = np.linspace(0.0, 0.5 * np.pi, 2001)
    costs = 1.0 - np.column_stack([np.cos(angles), np.sin(angles)])
    assert hypervolume(costs, np.ones(2)) == pytest.approx(0.25 * np.pi, abs=1e-3)


def test_nothing_within_the_reference():
    assert hypervolume(np.array([[1.0, 0.0]]), np.ones(2)) == 0.0
    assert hypervolume(np.empty((0, 2)), np.ones(2)) == 0.0
