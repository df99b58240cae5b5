"""The optimizers that choose their contexts: each on a small problem with a known optimum."""

import importlib

import numpy as np
import pytest

from bo_tuner.trials import Evaluation, EvaluationState, Outcome, Stage
from tuning_benchmark.campaign.runs import RunSize, run_and_judge
from tuning_benchmark.experiments.experiment import Row
from tuning_benchmark.peers.confidence_bounds import DEVIATIONS, Carbo, StableOpt
from tuning_benchmark.peers.robust import Result, result_of
from tuning_benchmark.problems.closed_form import ClosedForm

pytestmark = [pytest.mark.filterwarnings("ignore"), pytest.mark.timeout(600)]

JUDGE = "tuning_benchmark.judging.closed_form:Judge"
PEERS = {
    "StableOpt": ("tuning_benchmark.peers.confidence_bounds:StableOpt", ""),
    "CARBO": ("tuning_benchmark.peers.confidence_bounds:Carbo", ""),
    "scenarios": ("tuning_benchmark.peers.scenarios:ScenarioLoop", "cobyqa"),
    "risk": ("tuning_benchmark.peers.botorch_risk:RiskAverse", "botorch"),
}
SIZE = RunSize(evaluations=70, reserved=0, initial_trials=5)


@pytest.fixture(params=list(PEERS))
def peer(request):
    name, needs = PEERS[request.param]
    if needs:
        pytest.importorskip(needs, reason="needs requirements/benchmarks.txt")
    return name


def load(name):
    module, made = name.split(":")
    return getattr(importlib.import_module(module), made)


def told(optimizer, problem, count=12, seed=0, crash=()):
    """Tell an optimizer noise-free results at random points and contexts."""
    study = problem.study()
    space, contexts = study.search_space(), study.context_space()
    rng = np.random.default_rng(seed)
    for number in range(count):
        u, w = rng.random(problem.parameters), rng.uniform(-1.0, 1.0, problem.contexts)
        parameters = space.to_parameters(u)
        failed = number in crash
        cost = None if failed else float(np.log(problem.cost(u)))
        excess = None if failed else float(problem.metric(u, w)) - 1.0
        optimizer.tell(Result(parameters, contexts.to_dict(w), cost, excess))


@pytest.mark.slow
@pytest.mark.parametrize("name", ["StableOpt", "CARBO", "scenarios"])
def test_without_noise_it_comes_near_the_optimum(name):
    path, needs = PEERS[name]
    if needs:
        pytest.importorskip(needs, reason="needs requirements/benchmarks.txt")
    problem = ClosedForm(parameters=2, contexts=1)
    row = Row(name=name, optimizer=path, protocol="own")
    result = run_and_judge(problem.study(), row, 1, SIZE, JUDGE)
    truth = result["answer"]["truth"]
    assert result["cuts"] == SIZE.evaluations
    # Its initial samples: five of the plane, at best some tenths of the optimum's 1.3 away.
    assert truth["objective"] < 1.15 * float(problem.frontier(truth["worst"]))
    assert truth["worst"] < 1.1


def test_asks_are_evaluations_of_the_study(peer):
    problem = ClosedForm(parameters=2, contexts=2)
    study = problem.study()
    optimizer = load(peer)(study, seed=3)
    told(optimizer, problem, crash=(2, 5))
    space = study.search_space()
    for _ in range(3):
        parameters, context = optimizer.ask()
        assert set(parameters) == {"p1", "p2"}
        assert space.key(space.to_parameters(space.to_cube(parameters))) == space.key(parameters)
        assert set(context) == {"w1", "w2"}
        assert all(-1.0 <= value <= 1.0 for value in context.values())
        optimizer.tell(Result(parameters, context, 0.4, 0.1))
    assert set(optimizer.recommend()) >= {"p1", "p2"}


def test_the_same_seed_asks_the_same(peer):
    problem = ClosedForm(parameters=2, contexts=1)
    asked = []
    for _ in range(2):
        optimizer = load(peer)(problem.study(), seed=4)
        told(optimizer, problem)
        asked.append(optimizer.ask())
    assert asked[0] == asked[1]


def test_a_run_of_crashes_only_goes_on(peer):
    problem = ClosedForm(parameters=2, contexts=1)
    study = problem.study()
    optimizer = load(peer)(study, seed=5)
    told(optimizer, problem, count=6, crash=range(6))
    crashed = optimizer.ask()
    optimizer.tell(Result(*crashed, None, None))
    parameters, context = optimizer.ask()
    assert (parameters, context) != crashed
    for name, spec in study.parameters.items():
        assert spec.bounds[0] <= parameters[name] <= spec.bounds[1]


@pytest.mark.parametrize("made", [StableOpt, Carbo])
def test_the_value_bounds_what_the_models_say(made):
    """The optimistic value lies below the pessimistic one, by the definition of both bounds."""
    problem = ClosedForm(parameters=2, contexts=1)
    optimizer = made(problem.study(), seed=6)
    told(optimizer, problem)
    optimizer.ask()
    x = np.random.default_rng(7).random((20, 2))
    low, high = (optimizer._value(x, s * DEVIATIONS) for s in (-1.0, 1.0))
    assert (low <= high).all()
    assert (low < high).any()


def test_stable_opt_evaluates_where_the_upper_bound_is_largest():
    problem = ClosedForm(parameters=2, contexts=1)
    optimizer = StableOpt(problem.study(), seed=8)
    told(optimizer, problem, count=20)
    parameters, context = optimizer.ask()
    x = problem.study().search_space().to_cube(parameters)[None]
    w = np.linspace(0.0, 1.0, 201)[:, None]
    upper = optimizer._bound(0, x, w, DEVIATIONS)[0]
    found = optimizer._bound(0, x, np.array([[(context["w1"] + 1.0) / 2.0]]), DEVIATIONS)
    assert found[0, 0] >= upper.max() - 1e-3 * abs(upper.max())


def test_the_scenario_loop_adds_a_plant_worse_than_its_own():
    pytest.importorskip("cobyqa", reason="needs requirements/benchmarks.txt")
    from tuning_benchmark.peers.scenarios import DRAWN, ScenarioLoop

    problem = ClosedForm(parameters=2, contexts=1)
    study = problem.study()
    optimizer = ScenarioLoop(study, seed=9)
    told(optimizer, problem)
    space = study.search_space()
    for _ in range(400):
        parameters, context = optimizer.ask()
        u = space.to_cube(parameters)
        w = np.array([context["w1"]])
        excess = float(problem.metric(u, w)) - 1.0
        optimizer.tell(Result(parameters, context, float(np.log(problem.cost(u))), excess))
    assert len(optimizer._plants) > DRAWN
    assert abs(optimizer._plants[DRAWN]["w1"]) == 1.0
    answer = space.to_cube(optimizer.recommend())
    assert problem.worst(answer)[0] <= 1.0 + 1e-9
    assert float(problem.cost(answer)) < 1.1 * problem.best


def test_a_result_is_on_the_scales_that_optimizers_see():
    study = ClosedForm(parameters=2, contexts=1).study()
    parameters, context = {"p1": 1.0, "p2": 2.0}, {"w1": 0.5}
    outcome = Outcome(EvaluationState.COMPLETE, {"cost": np.e, "stress": 1.25})
    done = Evaluation(0, 0, Stage.SEARCH, parameters, context, 1, outcome)
    assert result_of(study, done) == Result(parameters, context, pytest.approx(1.0), 0.25)
    failed = Evaluation(0, 0, Stage.SEARCH, parameters, context, 1)
    assert result_of(study, failed) == Result(parameters, context, None, None)


def test_all_rows_of_a_seed_share_their_initial_trials():
    from tuning_benchmark.campaign.own_contexts import OwnContextsRun
    from tuning_benchmark.campaign.runs import Run

    study = ClosedForm(parameters=2, contexts=1, noise="constant").study()
    size = RunSize(evaluations=40, reserved=0, initial_trials=3)
    ours = Run(study, Row(name="IV", algorithm="IV"), 2, size)
    own = OwnContextsRun(ours.study, StableOpt(ours.study, 2), size.evaluations)
    first = [trial for trial, _ in zip(ours, range(3), strict=False)]
    theirs = [trial for trial, _ in zip(own, range(3), strict=False)]
    assert [t.evaluations for t in first] == [t.evaluations for t in theirs]
