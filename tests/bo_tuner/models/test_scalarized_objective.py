"""The cost of several objectives, each by a process of its own, against draws of the posteriors."""

from types import SimpleNamespace

import numpy as np
import pytest

from bo_tuner.methods.registry import METHODS
from bo_tuner.models.pooled_models import PooledModels
from bo_tuner.models.scalarization import Chebyshev, equal_weights
from bo_tuner.models.scalarized_objective import ScalarizedObjective
from bo_tuner.trials import TrialState
from bo_tuner.tuning.driver import Driver
from bo_tuner.tuning.loop import Tuning

POINTS = np.array([[0.2], [0.8]])
X = np.array([[0.1], [0.2], [0.5]])
MEANS = np.array([[0.2, 1.4], [0.3, 1.2], [0.9, 0.5]])
"""None of them where both weighted costs are alike."""


def cost(means, deviation):
    return SimpleNamespace(
        predict=lambda x: (means, np.full(len(x), deviation**2)),
        predict_mean=lambda x: means,
        evaluated=lambda x: np.isin(x[:, 0], POINTS),
        variance_of_run=lambda x: np.full(len(x), 9.0 * deviation**2),
        points=POINTS,
    )


@pytest.fixture
def chebyshev():
    return Chebyshev(np.array([0.4, 0.6]), np.array([0.0, 0.5]), np.array([1.0, 2.5]))


@pytest.fixture
def scalarized(chebyshev):
    return ScalarizedObjective((cost(MEANS[:, 0], 0.02), cost(MEANS[:, 1], 0.04)), chebyshev)


@pytest.mark.parametrize(("method", "factor"), [("predict", 1.0), ("variance_of_run", 3.0)])
def test_mean_and_variance_are_those_of_draws(scalarized, chebyshev, method, factor):
    rng = np.random.default_rng(0)
    draws = rng.normal(MEANS, factor * np.array([0.02, 0.04]), (20_000, 3, 2))
    values = np.array([chebyshev(draws[:, k]) for k in range(3)])
    found = getattr(scalarized, method)(X)
    if method == "predict":
        mean, found = found
        assert mean == pytest.approx(values.mean(axis=1), abs=1e-3)
        assert scalarized.predict_mean(X) == pytest.approx(mean)
    assert found == pytest.approx(values.var(axis=1), rel=0.05)


def test_at_its_data_nothing_is_left_to_learn(scalarized):
    mean, variance = scalarized.predict_reinterpolated(X)
    assert mean == pytest.approx(scalarized.predict_mean(X))
    assert (variance == 0.0).tolist() == [False, True, False]


def test_other_weights_are_those_of_another_scalarization(scalarized, chebyshev):
    weights = np.array([0.9, 0.1])
    there = scalarized.weighted(weights)
    assert there.predict_mean(X) == pytest.approx(
        Chebyshev(weights, chebyshev.ideal, chebyshev.nadir)(MEANS)
    )


def test_each_objective_has_its_own_process_over_the_contexts(make_study, function_backend):
    """The means over the load, from 1 to 2, and not those of the loads that were seen."""
    study = make_study(further_objectives=[{"metric": "peak"}]).replace(
        trials=12, initial_trials=12
    )

    def axis(gain, load, seed):
        return {"error": gain + load, "peak": 1.0 - gain * load}

    trials = list(Tuning(study, Driver(function_backend(study, axis)), METHODS["boundary"]))
    models = PooledModels()(study, trials, rng=np.random.default_rng(0), weights=equal_weights(2))
    gain = np.array([0.3])
    cube = study.search_space().cube_of([{"gain": 0.3}])
    assert models.costs["error"].predict_mean(cube) == pytest.approx(gain + 1.5, abs=0.02)
    assert models.costs["peak"].predict_mean(cube) == pytest.approx(1.0 - 1.5 * gain, abs=0.02)
    assert all(trial.state is TrialState.COMPLETE for trial in trials)
    assert {"objective", "objective_peak"} <= models.warm_starts.keys()
