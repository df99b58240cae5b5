"""The optima of the closed-form problems against independent searches, and their runs."""

import numpy as np
import pytest
from scipy.optimize import NonlinearConstraint, differential_evolution, minimize
from scipy.stats import norm, truncnorm

from bo_tuner.errors import StudyError
from bo_tuner.methods.registry import METHODS
from bo_tuner.trials import TrialState
from bo_tuner.tuning.driver import Driver
from tuning_benchmark.campaign.runs import TimedBackend
from tuning_benchmark.judging.evaluator import Evaluator
from tuning_benchmark.judging.truth import Effort, Truth
from tuning_benchmark.problems.closed_form import ClosedForm
from tuning_benchmark.problems.warp import warped

JUDGE = "tuning_benchmark.judging.closed_form:Judge"
SIZES = [(2, 1), (2, 3), (4, 2), (8, 4), (12, 6)]
PROBLEMS = [
    *({"parameters": d, "contexts": m} for d, m in SIZES),
    *({"parameters": 3, "contexts": m, "narrow": True} for m in (1, 2)),
]
NAMES = [ClosedForm(**problem).name for problem in PROBLEMS]
SMALL = Effort(drawn=50, grid=3, real_evaluations=0)


def boundless_worst(problem, u):
    """Largest mean over the box of contexts, by a bounded search from many starts."""
    rng = np.random.default_rng(1)
    starts = rng.uniform(-1.0, 1.0, (12, problem.contexts))
    box = [(-1.0, 1.0)] * problem.contexts
    found = [minimize(lambda w: -problem.metric(u, w), w, bounds=box, tol=1e-12) for w in starts]
    corners = np.array(np.meshgrid(*[[-1.0, 0.0, 1.0]] * problem.contexts)).reshape(
        problem.contexts, -1
    )
    return max(*(-f.fun for f in found), problem.metric(u, corners.T).max())


@pytest.mark.parametrize("settings", PROBLEMS, ids=NAMES)
def test_the_worst_context_is_that_of_a_numerical_search(settings):
    problem = ClosedForm(**settings)
    for u in np.random.default_rng(0).random((8, problem.parameters)):
        worst, context = problem.worst(u)
        assert (np.abs(context) <= 1.0).all()
        assert worst == pytest.approx(problem.metric(u, context))
        assert worst == pytest.approx(boundless_worst(problem, u), abs=1e-6)


@pytest.mark.parametrize("settings", PROBLEMS, ids=NAMES)
def test_the_optimum_keeps_the_limit_exactly_and_is_on_the_frontier(settings):
    problem = ClosedForm(**settings)
    assert ((problem.optimum > 0.0) & (problem.optimum < 1.0)).all()
    assert problem.worst(problem.optimum)[0] == pytest.approx(1.0, abs=1e-9)
    assert problem.best == pytest.approx(float(problem.frontier(1.0)), abs=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize(
    "settings",
    [
        {"parameters": 2, "contexts": 1},
        {"parameters": 2, "contexts": 3},
        {"parameters": 4, "contexts": 2},
        {"parameters": 3, "contexts": 2, "narrow": True},
    ],
)
@pytest.mark.parametrize("limit", [1.0, 0.9])
def test_differential_evolution_finds_no_better_point(settings, limit):
    problem = ClosedForm(**settings)
    found = differential_evolution(
        lambda u: float(problem.cost(u)),
        [(0.0, 1.0)] * problem.parameters,
        constraints=NonlinearConstraint(lambda u: problem.worst(u)[0], -np.inf, limit),
        seed=1,
        tol=1e-10,
        maxiter=150,
        polish=False,
    )
    assert found.maxcv <= 1e-9
    assert found.fun == pytest.approx(float(problem.frontier(limit)), rel=5e-4)
    assert found.fun >= float(problem.frontier(limit)) - 1e-9


@pytest.mark.parametrize("settings", PROBLEMS, ids=NAMES)
@pytest.mark.parametrize("limit", [1.0, 0.95])
def test_a_local_search_from_many_starts_finds_no_better_point(settings, limit):
    """In the convex relaxation of contexts by enumeration, one smooth constraint for each."""
    problem = ClosedForm(**settings)
    rng = np.random.default_rng(2)
    ends = problem.worst_contexts(problem.optimum)

    def left(u):
        return limit - problem.metric(u, contexts_of(problem, ends, u))

    best = np.inf
    for start in np.vstack([problem.optimum, rng.uniform(0.3, 0.7, (3, problem.parameters))]):
        found = minimize(
            lambda u: float(problem.cost(u)),
            start,
            bounds=[(0.0, 1.0)] * problem.parameters,
            constraints={"type": "ineq", "fun": left},
            method="SLSQP",
            options={"ftol": 1e-12, "maxiter": 400},
        )
        if left(found.x).min() >= -1e-8:
            best = min(best, found.fun)
    assert best == pytest.approx(float(problem.frontier(limit)), rel=1e-5)


def every_third(problem):
    return np.arange(problem.contexts) % 3 == 2


def contexts_of(problem, ends, u):
    """The rows of `ends` with the contexts that are worst inside where they are worst for u."""
    interior = np.full(problem.contexts, True) if problem.narrow else every_third(problem)
    return np.where(interior, problem.worst_contexts(u)[0], ends)


@pytest.mark.parametrize("noise", ["constant", "heteroscedastic"])
@pytest.mark.parametrize("size", SIZES)
def test_single_runs_keep_the_limit_at_the_optimum_as_often_as_promised(noise, size):
    problem = ClosedForm(parameters=size[0], contexts=size[1], noise=noise, probability=0.85)
    assert problem.kept(problem.optimum) == pytest.approx(0.85, abs=1e-9)
    assert np.mean(problem.runs(problem.optimum) <= 1.0) == pytest.approx(0.85, abs=1e-3)
    # No context is worse, of many.
    w = np.random.default_rng(3).uniform(-1.0, 1.0, (20_000, size[1]))
    kept = norm.cdf(
        (1.0 - problem.metric(problem.optimum, w)) / problem.deviation(problem.optimum, w)
    )
    assert kept.min() >= 0.85 - 1e-9
    step = problem.constants.D * 1e-3
    assert problem.kept(problem.optimum + step) < 0.85 < problem.kept(problem.optimum - step)


@pytest.mark.slow
def test_differential_evolution_finds_no_better_point_for_single_runs():
    problem = ClosedForm(parameters=2, contexts=2, noise="heteroscedastic", probability=0.85)
    found = differential_evolution(
        lambda u: float(problem.cost(u)),
        [(0.0, 1.0)] * 2,
        constraints=NonlinearConstraint(problem.kept, 0.85, np.inf),
        seed=1,
        tol=1e-10,
        maxiter=150,
        polish=False,
    )
    assert found.fun == pytest.approx(problem.best, rel=5e-4)


def test_the_crash_region_begins_at_the_optimum_and_holds_no_feasible_point():
    problem = ClosedForm(parameters=4, contexts=2, crash=True)
    assert not problem.crashes(problem.optimum)
    assert problem.crashes(problem.optimum + 0.1 * problem.constants.D)
    points = np.random.default_rng(4).random((2000, 4))
    crashed = np.array([problem.crashes(u) for u in points])
    assert 0.1 < crashed.mean() < 0.9
    assert all(problem.worst(u)[0] > 1.0 for u in points[crashed])


def test_runs_fail_around_the_default_and_not_at_the_optimum():
    problem = ClosedForm(parameters=4, contexts=2, noise="constant", crash_at_default=True)
    study = problem.study()
    space = study.search_space()
    (start,) = study.starting_sets()
    assert start == space.defaults
    default = space.to_cube(start)
    assert problem.crashes(default)
    # 0.35 in each coordinate is the edge of the region.
    inwards = np.where(default > 0.5, -1.0, 1.0)
    assert problem.crashes(default + 0.349 * inwards)
    assert not problem.crashes(default + 0.351 * inwards)
    assert not problem.crashes(problem.optimum)
    crashed = [problem.crashes(u) for u in np.random.default_rng(4).random((2000, 4))]
    assert 0.02 < np.mean(crashed) < 0.5


def test_discrete_contexts_have_the_worst_case_of_their_interval():
    problem = ClosedForm(parameters=4, contexts=2, noise="heteroscedastic", discrete=True)
    same = ClosedForm(parameters=4, contexts=2, noise="heteroscedastic")
    assert problem.best == same.best
    contexts = problem.study().context_space()
    drawn = contexts.draw_stratified(300, np.random.default_rng(0))
    assert np.unique(drawn).tolist() == [-1.0, 0.0, 1.0]
    grid = np.array(np.meshgrid([-1.0, 0.0, 1.0], [-1.0, 0.0, 1.0])).reshape(2, -1).T
    for u in np.random.default_rng(1).random((20, 4)):
        assert problem.worst(u)[0] == pytest.approx(problem.metric(u, grid).max())


@pytest.mark.parametrize("probability", [None, 0.85])
def test_the_optimum_of_mixed_parameters_is_a_parameter_set(probability):
    settings = {"parameters": 3, "contexts": 2, "noise": "constant", "probability": probability}
    problem, reals = ClosedForm(mixed=True, **settings), ClosedForm(**settings)
    study = problem.study()
    space = study.search_space()
    assert [p.type for p in study.parameters.values()] == ["double", "double", "integer", "string"]
    values = dict(space.defaults) | {"p3": 0, "mode": "b"}
    for i in (0, 1):
        lower, upper, scale = problem.bounds(i)
        u = reals.optimum[i]
        between = lower + (upper - lower) * u
        values[f"p{i + 1}"] = lower * (upper / lower) ** u if scale == "log" else between
    assert problem.point(values) == pytest.approx(reals.optimum)
    low, high = study.parameters["p3"].bounds
    assert 0.0 <= problem.point(values | {"p3": low})[2] < 1.0 / 12.0
    assert 11.0 / 12.0 < problem.point(values | {"p3": high})[2] <= 1.0
    truth = Truth(study, JUDGE, SMALL)
    objectives = {
        mode: truth.verdict(values | {"mode": mode}).objective for mode in ("a", "b", "c")
    }
    assert objectives["b"] == pytest.approx(reals.best)
    assert objectives["a"] == pytest.approx(1.15 * reals.best)
    assert objectives["c"] == pytest.approx(1.3 * reals.best)
    # Runs have the factor, too: with the same seed, the same noise.
    evaluator = Evaluator(study)
    costs = [
        evaluator.metrics(values | {"mode": mode}, {"w1": 0.0, "w2": 0.0}, 1)["cost"]
        for mode in ("b", "c")
    ]
    assert costs[1] == pytest.approx(1.3 * costs[0])


@pytest.mark.parametrize("contexts", [1, 2])
def test_a_narrow_peak_breaks_the_limit_inside_and_in_no_corner(contexts):
    """By up to 0.35 in the worst context, as h·Δ says, but by nothing at an end of an interval."""
    problem = ClosedForm(parameters=3, contexts=contexts, narrow=True, noise="constant")
    points = np.random.default_rng(6).random((2000, 3))
    slope = (warped(points) - problem.constants.x) @ problem.constants.h
    near = points[(slope > 0.0) & (slope < 0.35)]
    assert len(near) > 100
    ends = np.array(np.meshgrid(*[[-1.0, 1.0]] * contexts)).reshape(contexts, -1).T
    hidden = 0
    for u, excess in zip(near, slope[(slope > 0.0) & (slope < 0.35)], strict=True):
        assert problem.worst(u)[0] == pytest.approx(1.0 + excess)
        hidden += problem.metric(u, ends).max() < 1.0
    assert hidden > 0.9 * len(near)
    # Away from the peak by three of its widths all is 0.49 lower, for each context.
    worst, context = problem.worst(problem.optimum)
    away = problem.metric(problem.optimum, context - 0.6)
    assert worst - away == pytest.approx(0.5 * (1.0 - np.exp(-4.5)) * contexts)


def test_a_steep_metric_is_the_same_within_its_limit_and_explodes_beyond():
    gentle = ClosedForm(parameters=4, contexts=3, noise="heteroscedastic")
    steep = ClosedForm(parameters=4, contexts=3, noise="heteroscedastic", steep=True)
    rng = np.random.default_rng(5)
    u, w = rng.random((2000, 4)), rng.uniform(-1.0, 1.0, (2000, 3))
    beyond = gentle.metric(u, w) - 1.0
    expected = np.where(beyond > 0.0, 0.15 * (np.exp(beyond / 0.15) - 1.0), beyond)
    assert steep.metric(u, w) - 1.0 == pytest.approx(expected)
    slope = np.where(beyond > 0.0, np.exp(beyond / 0.15), 1.0)
    assert steep.deviation(u, w) == pytest.approx(gentle.deviation(u, w) * slope)
    assert steep.metric(u, w).max() > 50.0
    # So the optimum is the same, and what it costs to exceed the limit by as much.
    assert steep.best == gentle.best
    for limit in (0.9, 1.0, 1.2):
        there = limit if limit <= 1.0 else 1.0 + 0.15 * np.expm1((limit - 1.0) / 0.15)
        assert steep.frontier(there) == pytest.approx(gentle.frontier(limit))


@pytest.mark.parametrize("steep", [False, True])
def test_evaluations_have_the_expectations_of_the_formulas(steep):
    problem = ClosedForm(parameters=4, contexts=3, noise="heteroscedastic", steep=steep)
    study = problem.study()
    space, contexts = study.search_space(), study.context_space()
    u = np.full(4, 0.4)
    parameters = space.to_parameters(u)
    evaluator = Evaluator(study)
    rows = contexts.draw_stratified(4000, np.random.default_rng(0))
    found = [evaluator.metrics(parameters, contexts.to_dict(w), i) for i, w in enumerate(rows)]
    cost = np.array([m["cost"] for m in found])
    noise = np.array([m["stress"] for m in found]) - problem.metric(u, rows)
    error = cost.std() / np.sqrt(len(cost))
    assert cost.mean() == pytest.approx(float(problem.cost(u)), abs=4.0 * error)
    scaled = noise / problem.deviation(u, rows)
    assert scaled.mean() == pytest.approx(0.0, abs=4.0 / np.sqrt(4000))
    assert scaled.std() == pytest.approx(1.0, abs=0.05)
    # The study's distribution of contexts has the mean that the formula of E[C] assumes.
    assert truncnorm(-2.5, 2.5, 0.0, 0.4).mean() == pytest.approx(0.0)
    assert rows.mean(axis=0) == pytest.approx(np.zeros(3), abs=0.01)


def test_the_judge_says_what_the_problem_knows():
    problem = ClosedForm(parameters=4, contexts=2, noise="constant", crash=True, probability=0.85)
    study = problem.study()
    truth = Truth(study, JUDGE, SMALL)
    space = study.search_space()
    inside = problem.optimum - 1e-6 * problem.constants.D
    verdict = truth.verdict(space.to_parameters(inside))
    assert verdict.feasible
    assert verdict.objective == pytest.approx(problem.best, abs=1e-4)
    assert verdict.worst_kept == pytest.approx(0.85, abs=1e-3)
    assert not truth.verdict(
        space.to_parameters(problem.optimum + 0.01 * problem.constants.D)
    ).feasible
    crashed = truth.verdict(space.to_parameters(problem.optimum + 0.2 * problem.constants.D))
    assert not crashed.feasible
    assert np.isnan(crashed.objective)


def test_a_crash_is_a_failed_trial_of_the_product():
    from bo_tuner.tuning.loop import Tuning

    problem = ClosedForm(parameters=2, contexts=1, crash=True)
    study = problem.study().replace(trials=6, initial_trials=6)
    backend = TimedBackend(study)
    backend.open()
    space = study.search_space()
    for trial in Tuning(study, Driver(backend), METHODS["IV"]):
        crashed = problem.crashes(space.to_cube(trial.parameters))
        assert (trial.state is TrialState.FAILED) == crashed


def test_the_warping_keeps_the_cube_and_its_order():
    u = np.linspace(0.0, 1.0, 1001)
    assert warped(u)[[0, -1]] == pytest.approx([0.0, 1.0])
    assert (np.diff(warped(u)) > 0.0).all()


@pytest.mark.parametrize(
    "wrong",
    [
        {"parameters": 1},
        {"contexts": 0},
        {"noise": "loud"},
        {"crash": 1},
        {"steep": 1},
        {"steep": True, "probability": 0.9},
        {"narrow": 1},
        {"narrow": True, "noise": "heteroscedastic"},
        {"mixed": 1},
        {"discrete": True, "contexts": 3},
        {"discrete": True, "narrow": True},
    ],
)
def test_wrong_settings_are_refused(wrong):
    with pytest.raises(StudyError):
        ClosedForm(**({"parameters": 2, "contexts": 1} | wrong))
