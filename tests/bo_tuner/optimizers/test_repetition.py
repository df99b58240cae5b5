from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from bo_tuner.models.categories import Coding
from bo_tuner.models.joint_process import JointProcess
from bo_tuner.models.joint_responses import EveryContext, PooledResponse
from bo_tuner.optimizers.ranking import Candidate
from bo_tuner.optimizers.repetition import OWN_RUNS, next_repetition
from bo_tuner.trials import Stage

SPREAD = 0.05


class Stress(PooledResponse):
    """The parameter itself, with the same variance everywhere, which is also that of a run."""

    limit, sign = 1.0, 1.0

    def predict(self, x):
        return self.forecast(x)[:2]

    def forecast(self, x):
        return x[:, 0], np.full(len(x), SPREAD**2), np.full(len(x), SPREAD**2)


class Cost:
    """What is lacking to the parameter, without doubt."""

    scale = 1.0

    def predict(self, x):
        return -x[:, 0], np.full(len(x), 1e-12)


@pytest.fixture
def study(make_study):
    return make_study(
        parameters={"x": {"node": "axis", "type": "double", "bounds": [0.0, 1.0], "default": 0.0}}
    )


@pytest.fixture
def candidate(make_trial):
    def make(number, x, feasibility):
        return Candidate(make_trial(number, {"x": x}, [1.0]), 0.0, feasibility, 0.0, 0.0, -x, 0.975)

    return make


def test_what_no_budget_shows_is_not_run_again(study, candidate):
    """The better one has the larger product of gain and probability, but hardly ever is shown."""
    surrogates = SimpleNamespace(limits=(Stress(),), objective=Cost())
    best, sure, close = candidate(0, 0.9, 0.98), candidate(1, 0.93, 0.92), candidate(2, 0.985, 0.62)
    assert (0.985 - 0.9) * close.feasibility > (0.93 - 0.9) * sure.feasibility
    chosen = next_repetition(study, surrogates, [best, close, sure], 40)
    assert chosen.trial.number == 1
    assert chosen.runs == 2


def test_nothing_is_run_again_for_a_negligible_gain(study, candidate):
    surrogates = SimpleNamespace(limits=(Stress(),), objective=Cost())
    best, other = candidate(0, 0.9, 0.98), candidate(1, 0.9005, 0.97)
    assert next_repetition(study, surrogates, [best, other], 40) is None


def test_without_an_answer_the_most_provable_one_is_run_again(study, candidate):
    surrogates = SimpleNamespace(limits=(Stress(),), objective=Cost())
    open_ones = [candidate(k, x, 0.5) for k, x in enumerate((0.99, 0.95, 0.97))]
    assert next_repetition(study, surrogates, open_ones, 40).trial.number == 1


@pytest.mark.parametrize(("done", "runs"), [(0, OWN_RUNS), (3, 1), (4, 0)])
def test_an_answer_has_runs_of_its_own_and_no_more(study, candidate, done, runs):
    """Also far from the limit: a model can be wrong. Its most doubtful context may move then."""
    rng = np.random.default_rng(0)
    contexts = study.context_space()
    x, c = rng.random((60, 1)), rng.random((60, contexts.dimension))
    y = x[:, 0] + rng.normal(0.0, 0.1, 60)
    process = JointProcess.fit(x, c, y, coding=Coding((0,)), rng=rng)
    constraint = EveryContext(process, 5.0, contexts.candidates())
    surrogates = SimpleNamespace(limits=(constraint,), objective=Cost())
    best = candidate(0, 0.95, 0.98)
    (evaluation,) = best.trial.evaluations
    (row,), _ = constraint.most_doubtful(np.array([[0.95]]))
    far = 1.0 - contexts.candidates()[row]
    elsewhere = contexts.to_dict(contexts.to_contexts(far[None])[0])
    check = replace(evaluation, stage=Stage.CHECK_WORST, context=elsewhere)
    trial = replace(best.trial, evaluations=(check,) * done)
    found = next_repetition(study, surrogates, [replace(best, trial=trial)], 40)
    assert (0 if found is None else found.runs) == runs
