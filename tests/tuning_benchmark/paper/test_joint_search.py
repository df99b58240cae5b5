"""Algorithm V: the joint model, on functions whose worst case is known."""

import numpy as np
import pytest

from bo_tuner.methods.registry import METHODS
from bo_tuner.models.gaussian_process import GaussianProcess
from bo_tuner.optimizers.base import Proposal
from bo_tuner.study.context_space import CANDIDATES, MOST_CORNER_DIMENSIONS, ContextSpace
from bo_tuner.study.distributions import Discrete, Uniform
from tuning_benchmark.paper.constraints import JointConstraint
from tuning_benchmark.paper.joint_search import JointSearch

NOISE = 0.01


@pytest.fixture
def plane():
    return ContextSpace({"a": Uniform(bounds=(0.0, 2.0)), "b": Uniform(bounds=(-1.0, 1.0))})


def response(x, c):
    """Worst at a = 2, b = -1 for every x, where it is x + 1.5; c in the unit cube."""
    return x[:, 0] + c[:, 0] + 0.5 * (1.0 - c[:, 1]) + 0.2 * x[:, 0] * (c[:, 0] - 1.0)


def observed(count, seed=0):
    rng = np.random.default_rng(seed)
    rows = rng.random((count, 3))
    values = response(rows[:, :1], rows[:, 1:]) + NOISE * rng.normal(size=count)
    return rows, values


class TestCandidateContexts:
    def test_corners_and_inside(self, plane):
        contexts = plane.candidates()
        assert {tuple(row) for row in contexts[:4]} == {(0, 0), (0, 1), (1, 0), (1, 1)}
        assert ((contexts[4:] > 0) & (contexts[4:] < 1)).all()
        assert np.array_equal(contexts, plane.candidates())

    def test_many_variables(self):
        space = ContextSpace({f"c{k}": Uniform(bounds=(0.0, 1.0)) for k in range(9)})
        corners, inside = np.split(space.candidates(), [2**MOST_CORNER_DIMENSIONS])
        assert len({tuple(row) for row in corners}) == len(corners)
        assert set(corners[:, :MOST_CORNER_DIMENSIONS].flat) == {0.0, 1.0}
        assert set(corners[:, MOST_CORNER_DIMENSIONS:].flat) == {0.5}
        assert inside.shape == (CANDIDATES, 9)
        assert ((inside > 0) & (inside < 1)).all()

    def test_discrete_values_are_possible_ones(self):
        space = ContextSpace(
            {"load": Discrete(values=(0.0, 1.0, 4.0), probabilities=(0.5, 0.3, 0.2))}
        )
        assert set(space.candidates()[:, 0]) <= {0.0, 0.25, 1.0}


class TestJointConstraint:
    def test_is_the_worst_case_of_every_parametrization(self, plane):
        model = GaussianProcess.fit(*observed(150), rng=np.random.default_rng(0))
        constraint = JointConstraint(model, 2.0, contexts=plane.candidates())
        x = np.linspace(0.0, 1.0, 9)[:, None]
        mean, variance = constraint.predict(x)
        truth = x[:, 0] + 1.5
        assert mean == pytest.approx(truth, abs=0.03)
        assert np.all(np.abs(mean - truth) < 4.0 * np.sqrt(variance) + 0.01)
        probability = np.exp(constraint.log_probability(x))
        assert probability[truth < 1.9].min() > 0.95
        assert probability[truth > 2.1].max() < 0.05


class TestJointSearch:
    def search(self, space, limit, x=0.5, evaluations=10, history=60, seed=0):
        rng = np.random.default_rng(seed)
        rows, values = observed(history, seed) if history else (np.empty((0, 3)), np.empty(0))
        found = JointSearch(space, limit, 0.5, evaluations, np.array([x]), rows, values)

        def evaluation(context):
            c = space.to_cube([[context[name] for name in space.names]])
            found.tell(context, response(np.array([[x]]), c)[0] + NOISE * rng.normal())

        for row in space.draw(5, rng):
            evaluation(space.to_dict(row))
        asked = []
        while not found.done(rng):
            asked.append(found.ask(rng))
            evaluation(asked[-1])
        return found, asked

    @pytest.mark.parametrize("limit", [1.0, 3.5])
    def test_a_clear_decision_needs_no_search(self, plane, limit):
        """Earlier trials show that the worst case 2.0 is far from the limit."""
        _, asked = self.search(plane, limit)
        assert len(asked) <= 1

    def test_evaluations_go_where_the_decision_turns(self, plane):
        found, asked = self.search(plane, 2.0)
        assert asked, "a limit at the worst case cannot be decided without an evaluation"
        worst = found.worst_case(np.random.default_rng(0))
        assert worst.value == pytest.approx(2.0, abs=0.03)
        assert worst.context == pytest.approx({"a": 2.0, "b": -1.0}, abs=0.2)
        assert worst.noise == pytest.approx(NOISE, rel=0.6)

    def test_without_history(self, plane):
        found, asked = self.search(plane, 2.0, history=0)
        assert 1 <= len(asked) <= 10
        assert found.worst_case(np.random.default_rng(0)).value == pytest.approx(2.0, abs=0.1)

    def test_no_evaluations_left(self, plane):
        _, asked = self.search(plane, 2.0, evaluations=0)
        assert asked == []


def test_an_outlier_is_no_data_of_the_search(make_study, make_trial):
    """It is none of the models, whose hyperparameters it would be taken with."""
    constraint = {"kind": "worst_case", "metric": "peak", "upper": 1.0}
    study = make_study(constraints={"peak": constraint})
    trials = [make_trial(k, {"gain": 0.1 * k}, [1.0, 1.1], worst=0.5 + 0.01 * k) for k in range(8)]
    wild = make_trial(8, {"gain": 0.9}, [9.0, 9.0], worst=50.0)
    proposal = Proposal({"gain": 0.45}, "acquisition", outliers=frozenset({8}))
    found = []
    for known in (trials, [*trials, wild]):
        search = METHODS["V"].search(study, study.constraints["peak"], proposal, known, 10)
        search.tell({"load": 1.5}, 0.53)
        found.append(search.worst_case(np.random.default_rng(0)))
    assert found[0] == found[1]
    assert found[0].noise < 0.1
