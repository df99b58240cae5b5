"""Stage one with ask and tell, on cheap functions with a known optimum."""

import dataclasses
import itertools

import numpy as np
import pytest

from bo_tuner.methods.registry import METHODS
from bo_tuner.optimizers.bayesian import BayesianOptimization
from bo_tuner.run_notes import Notes, Unusable
from bo_tuner.trials import (
    Evaluation,
    EvaluationState,
    Outcome,
    Stage,
    TrialState,
)
from tuning_benchmark.paper.random_search import RandomSearch
from tuning_benchmark.paper.trial_models import TrialModels

NODE = {"node": "axis"}
OPTIMUM = 0.3


def double(lower=0.0, upper=1.0):
    return NODE | {"type": "double", "bounds": [lower, upper], "default": (lower + upper) / 2}


def integer(lower, upper):
    return NODE | {"type": "integer", "bounds": [lower, upper], "default": lower}


def bowl(parameters):
    """Zero at 0.3 of the doubles and at 4 of the integers."""
    return sum(
        (value - 4) ** 2 / 25 if isinstance(value, int) else (value - OPTIMUM) ** 2
        for value in parameters.values()
    )


@pytest.fixture
def study_of(make_study):
    """Function that makes a study of given parameters, with one peak constraint."""

    def make(parameters, trials=20, initial=6, **sections):
        budget = {"trials": trials, "initial_trials": initial, "drawn_contexts": 2}
        return make_study(parameters=parameters, budget=budget, **sections)

    return make


@pytest.fixture
def optimize(make_trial):
    """Function that runs ask and tell; `response(number, parameters)` gives errors and peak."""

    def run(study, response, stage_one=None):
        stage_one = stage_one or BayesianOptimization(study, TrialModels())
        proposals = []
        for number in range(study.budget.trials):
            proposal = stage_one.ask()
            proposals.append(proposal)
            errors, peak = response(number, proposal.parameters)
            stage_one.tell(make_trial(number, proposal.parameters, errors, peak))
        return proposals

    return run


def keys(study, proposals):
    space = study.search_space()
    return [space.key({n: p.parameters[n] for n in space.names}) for p in proposals]


def noisy_bowl(number, parameters):
    rng = np.random.default_rng(number)
    value = bowl(parameters)
    return (value + rng.normal(0.0, 0.002, 3)).tolist(), 0.5


class TestProposals:
    def test_starts_with_the_design_and_continues_with_the_model(self, study_of, optimize):
        proposals = optimize(study_of({"x": double(), "y": double()}), noisy_bowl)
        assert [p.origin for p in proposals[:6]] == ["initial"] * 6
        assert {p.origin for p in proposals[6:]} <= {"acquisition", "refinement"}
        assert not any(p.warnings for p in proposals)

    def test_a_latin_hypercube_covers_each_parameter(self, study_of, optimize):
        """Six points: one in each sixth of either range."""
        proposals = optimize(study_of({"x": double(), "y": double(-1.0, 1.0)}, 6), noisy_bowl)
        x = np.array([[p.parameters["x"], (p.parameters["y"] + 1) / 2] for p in proposals])
        assert np.all(np.sort(np.floor(6 * x), axis=0) == np.arange(6)[:, None])

    def test_finds_the_optimum(self, study_of, optimize):
        study = study_of({"x": double(), "y": double()}, trials=20)
        best = min(bowl(p.parameters) for p in optimize(study, noisy_bowl))
        # Of twenty random points one is as close as this in 3 of 100 cases only: 20 pi 0.0005.
        assert best < 0.0005

    def test_keeps_to_what_is_feasible(self, study_of, optimize):
        """The peak is x, its limit 0.2 lies short of the optimum 0.3: the best is at the limit."""
        constraint = {"kind": "worst_case", "metric": "peak", "upper": 0.2}
        study = study_of({"x": double()}, trials=10, constraints={"peak": constraint})

        def response(number, parameters):
            return noisy_bowl(number, parameters)[0], parameters["x"]

        proposals = optimize(study, response)
        asked = np.array([p.parameters["x"] for p in proposals[6:]])
        assert max(x for x in asked if x <= 0.2) > 0.17
        assert np.median(asked) < 0.22

    def test_keeps_away_from_failures(self, study_of, optimize):
        """Whatever lies above 0.5 fails: half of random proposals, at most a quarter of these."""

        def response(number, parameters):
            return ([], 0.0) if parameters["x"] > 0.5 else noisy_bowl(number, parameters)

        failures = 0
        for seed in (1, 2, 3):
            study = study_of({"x": double(), "y": double()}, trials=20, seed=seed)
            failures += sum(p.parameters["x"] > 0.5 for p in optimize(study, response)[6:])
        assert failures <= 3 * 14 / 4

    def test_a_failure_is_not_repeated_next_door(self, study_of, optimize):
        """The optimum fails, and all within 0.1: the border may be sounded, not the inside."""
        study = study_of({"x": double()}, trials=16)

        def response(number, parameters):
            near = abs(parameters["x"] - OPTIMUM) < 0.1
            return ([], 0.0) if near else noisy_bowl(number, parameters)

        proposals = optimize(study, response)
        failed = sorted(
            p.parameters["x"] for p in proposals if abs(p.parameters["x"] - OPTIMUM) < 0.1
        )
        assert len(failed) <= 5
        inside = [x for x in failed if abs(x - OPTIMUM) < 0.08]
        assert all(np.diff(inside) > 0.02)

    @pytest.mark.parametrize("dimension", [1, 12])
    def test_any_number_of_parameters(self, study_of, optimize, dimension):
        names = [f"p{k}" for k in range(dimension)]
        study = study_of({name: double() for name in names}, trials=12, initial=6)
        proposals = optimize(study, noisy_bowl)
        x = np.array([[p.parameters[name] for name in names] for p in proposals])
        assert np.all((x >= 0.0) & (x <= 1.0))
        assert len(set(keys(study, proposals))) == 12

    def test_tied_and_fixed_parameters_are_complete(self, study_of, optimize):
        parameters = {
            "m": integer(1, 9),
            "n": NODE | {"type": "integer", "tied_to": "m"},
            "c": NODE | {"type": "double", "fixed": 2.5},
        }
        for proposal in optimize(study_of(parameters, trials=9, initial=3), noisy_bowl):
            assert proposal.parameters["n"] == proposal.parameters["m"]
            assert proposal.parameters["c"] == 2.5
            assert isinstance(proposal.parameters["n"], int)

    def test_the_order_is_kept(self, study_of, optimize):
        parameters = {"m": integer(1, 6), "n": integer(1, 6), "x": double()}
        study = study_of(parameters, trials=16, order=[["m", "n"]])
        # The optimum without the order would be far outside of it.
        proposals = optimize(
            study, lambda k, p: ([p["n"] - p["m"] + p["x"] + 0.01 * (k % 3)] * 2, 0.5)
        )
        assert all(p.parameters["m"] <= p.parameters["n"] for p in proposals)
        assert sum(p.parameters["m"] == p.parameters["n"] for p in proposals[6:]) >= 6


class TestRepetition:
    @pytest.mark.parametrize(
        "parameters",
        [
            {"m": integer(1, 60), "n": integer(1, 30)},
            {"m": integer(1, 3), "x": double()},
            {"x": double(0.0, 1e-3)},
        ],
        ids=["integers", "mixed", "double"],
    )
    def test_nothing_is_tried_twice(self, study_of, optimize, parameters):
        study = study_of(parameters, trials=40)
        proposals = optimize(study, noisy_bowl)
        assert len(set(keys(study, proposals))) == 40

    def test_what_somebody_disturbed_is_proposed_again(self, study_of, make_trial):
        """Else it would be the best of an acquisition that may not be tried, trial by trial."""
        study = study_of({"n": integer(0, 9)}, initial=3)
        stage_one = BayesianOptimization(study, TrialModels())

        def tell(number, proposal, **outcome):
            trial = make_trial(
                number, proposal.parameters, noisy_bowl(number, proposal.parameters)[0], 0.5
            )
            stage_one.tell(dataclasses.replace(trial, **outcome))

        for number in range(3):
            tell(number, stage_one.ask())
        proposal = stage_one.ask()
        reason = "axis: parameter n is 1, expected 2 (changed by someone else)"
        unusable = Outcome(EvaluationState.FAILED, {}, reason, notes=Notes(Unusable.DISTURBED))
        evaluation = Evaluation(3, 0, Stage.DRAWN, proposal.parameters, {}, 1, unusable)
        tell(3, proposal, state=TrialState.FAILED, reason=reason, evaluations=(evaluation,))
        again = stage_one.ask()
        assert again.parameters == proposal.parameters
        assert again.origin != "space-filling"

    def test_a_small_space_is_tried_in_full(self, study_of, optimize):
        """Of 6 parameter sets none is left out, and the search still answers afterwards."""
        study = study_of({"m": integer(1, 3), "n": integer(1, 2)}, trials=9, initial=2)
        proposals = optimize(study, noisy_bowl)
        every = set(itertools.product([1, 2, 3], [1, 2]))
        assert set(keys(study, proposals[:6])) == every
        assert set(keys(study, proposals)) == every

    def test_a_design_larger_than_the_space(self, study_of, optimize):
        study = study_of({"m": integer(1, 3)}, trials=6, initial=5)
        proposals = optimize(study, noisy_bowl)
        assert {p.parameters["m"] for p in proposals} == {1, 2, 3}

    @pytest.mark.parametrize("method", [METHODS["IV"].optimizer, RandomSearch])
    def test_one_seed_one_sequence(self, study_of, optimize, method):
        parameters = {"m": integer(1, 9), "x": double()}
        runs = {}
        for seed in (5, 5, 6):
            study = study_of(parameters, trials=9, seed=seed)
            runs.setdefault(seed, []).append(optimize(study, noisy_bowl, method(study)))
        assert runs[5][0] == runs[5][1]
        assert runs[5][0] != runs[6][0]

    def test_random_search_has_the_same_design(self, study_of, optimize):
        study = study_of({"x": double(), "y": double()}, trials=9)
        by_model = optimize(study, noisy_bowl)
        by_chance = optimize(study, noisy_bowl, RandomSearch(study))
        assert by_model[:6] == by_chance[:6]
        assert [p.origin for p in by_chance[6:]] == ["random"] * 3


class TestPoorData:
    def answers(self, study, proposals):
        assert len(proposals) == study.budget.trials
        assert len(set(keys(study, proposals))) == study.budget.trials
        return proposals

    def test_all_fail(self, study_of, optimize):
        study = study_of({"x": double(), "m": integer(1, 9)}, trials=14)
        proposals = self.answers(study, optimize(study, lambda *_: ([], 0.0)))
        # Without any value it keeps its distance from what failed.
        x = np.array([[p.parameters["x"], (p.parameters["m"] - 1) / 8] for p in proposals])
        new = x[6]
        assert np.sqrt(((x[:6] - new) ** 2).sum(axis=1)).min() > 0.2

    @pytest.mark.parametrize("failing", [1, 6, 9])
    def test_the_first_fail(self, study_of, optimize, failing):
        study = study_of({"x": double(), "m": integer(1, 9)}, trials=14)
        self.answers(
            study, optimize(study, lambda k, p: ([], 0.0) if k < failing else noisy_bowl(k, p))
        )

    @pytest.mark.parametrize("value", [0.0, 1.0, -1e9, 1e300])
    def test_constant_responses(self, study_of, optimize, value):
        study = study_of({"x": double(), "m": integer(1, 9)}, trials=10)
        self.answers(study, optimize(study, lambda *_: ([value] * 3, value)))

    def test_one_value_for_each_trial(self, study_of, optimize):
        study = study_of({"x": double(), "m": integer(1, 9)}, trials=10)
        self.answers(study, optimize(study, lambda k, p: ([bowl(p)], 0.5)))

    def test_everything_violates(self, study_of, optimize):
        """Without a feasible point the search goes where the violation is smallest: x = 0."""
        study = study_of({"x": double()}, trials=14)
        proposals = self.answers(
            study, optimize(study, lambda k, p: (noisy_bowl(k, p)[0], 1.5 + p["x"]))
        )
        assert min(p.parameters["x"] for p in proposals[6:]) < 0.05

    def test_one_monstrous_value(self, study_of, optimize):
        study = study_of({"x": double(), "y": double()}, trials=14)

        def response(k, p):
            return ([1e12] * 3, 1e12) if k == 2 else noisy_bowl(k, p)

        self.answers(study, optimize(study, response))

    def test_log_scale(self, study_of, optimize):
        study = study_of({"x": double()}, trials=12, objective={"metric": "error", "scale": "log"})

        def response(k, p):
            return ([10.0 ** (8 * abs(p["x"] - OPTIMUM)) * (1 + 0.01 * j) for j in range(3)], 0.5)

        proposals = self.answers(study, optimize(study, response))
        assert min(abs(p.parameters["x"] - OPTIMUM) for p in proposals) < 0.02

    def test_maximizing(self, study_of, optimize):
        study = study_of(
            {"x": double()}, trials=12, objective={"metric": "error", "direction": "maximize"}
        )
        proposals = self.answers(study, optimize(study, lambda k, p: ([-bowl(p)] * 2, 0.5)))
        assert min(abs(p.parameters["x"] - OPTIMUM) for p in proposals) < 0.02
