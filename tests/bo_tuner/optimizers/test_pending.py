"""Stage one with trials that are pending: what is known of them, and what is not."""

from dataclasses import replace

import pytest

from bo_tuner.models.pooled_models import PooledModels
from bo_tuner.optimizers.base import INITIAL, RANDOM
from bo_tuner.optimizers.bayesian import BayesianOptimization
from bo_tuner.trials import Evaluation, Stage, TrialState

GAINS = (0.05, 0.2, 0.35, 0.5, 0.7, 0.95)


class Spy:
    """Fits the models, and keeps what it was asked for."""

    def __init__(self):
        self.fits = []
        self.models = PooledModels()

    def __call__(self, study, trials, **arguments):
        surrogates = self.models(study, trials, **arguments)
        self.fits.append((trials, arguments, surrogates))
        return surrogates


@pytest.fixture
def study(make_study):
    return make_study(constraints={}, budget={"trials": 20, "initial_trials": 1})


@pytest.fixture
def trial(make_trial):
    def make(number):
        gain = GAINS[number]
        errors = [1.0 + (gain - 0.6) ** 2 + noise for noise in (-0.01, 0.02)]
        return make_trial(number, {"gain": gain}, errors)

    return make


def pending(done, number):
    run = Evaluation(number, 0, Stage.DRAWN, dict(done.parameters), {"load": 1.5}, 0)
    return replace(done, number=number, state=TrialState.FAILED, evaluations=(run,))


def test_hyperparameters_are_those_of_the_results_alone(study, trial):
    spy = Spy()
    optimizer = BayesianOptimization(study, spy)
    for number in range(5):
        optimizer.tell(trial(number))
    awaited = [pending(trial(5), 5)]
    proposal = optimizer.ask(awaited)
    (known, of_known, fitted), (together, of_all, conditioned) = spy.fits
    assert [t.number for t in known] == [0, 1, 2, 3, 4]
    assert [t.number for t in together] == [0, 1, 2, 3, 4, 5]
    assert not of_known.get("keep", False)
    assert of_all["keep"]
    assert conditioned.objective.process.hyperparameters.to_log() == pytest.approx(
        fitted.objective.process.hyperparameters.to_log(), abs=1e-12
    )
    assert proposal.hyperparameters["objective"] == fitted.warm_starts["objective"]


def test_of_nothing_pending_there_is_one_fit(study, trial):
    spy = Spy()
    optimizer = BayesianOptimization(study, spy)
    for number in range(5):
        optimizer.tell(trial(number))
    optimizer.ask()
    assert len(spy.fits) == 1


def test_no_model_is_asked_while_hardly_a_trial_has_ended(study, trial):
    spy = Spy()
    optimizer = BayesianOptimization(study, spy)
    assert optimizer.ask().origin == INITIAL
    awaited = [pending(trial(k), k) for k in (1, 2)]
    optimizer.tell(trial(0))
    drawn = optimizer.ask(awaited)
    assert drawn.origin == RANDOM
    assert not spy.fits
    assert drawn.parameters["gain"] not in GAINS[:3]
    # Of the same trials the same again; with nothing pending there is no better than a model.
    assert optimizer.ask(awaited) == drawn
    assert optimizer.ask().origin != RANDOM
    for number in (1, 2):
        optimizer.tell(trial(number))
    assert optimizer.ask([pending(trial(3), 3)]).origin != RANDOM
