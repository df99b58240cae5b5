"""Models of all evaluations: on which scale costs are, against a cost in closed form."""

import numpy as np
import pytest
from functions import make_study

from bo_tuner.models.compression import NO_COMPRESSION
from bo_tuner.models.pooled_models import PooledModels
from bo_tuner.trials import Evaluation, EvaluationState, Outcome, Stage, Trial, TrialState

TRIED = np.linspace(0.0, 1.0, 11)


def cost(gain):
    """A valley at 0.3."""
    return np.cosh(8.0 * (gain - 0.3)) - 1.0


def models(sign=1.0, **sections):
    study = make_study(
        contexts={},
        constraints={},
        objective={"metric": "error", "direction": "minimize" if sign > 0.0 else "maximize"},
        **sections,
    )
    trials = []
    for number, gain in enumerate(map(float, TRIED)):
        outcome = Outcome(EvaluationState.COMPLETE, {"error": sign * cost(gain), "peak": 0.0}, "")
        run = Evaluation(number, 0, Stage.DRAWN, {"gain": gain}, {}, 0, outcome)
        trials.append(Trial(number, {"gain": gain}, "", TrialState.COMPLETE, "", (run,)))
    return study, PooledModels()(study, trials, rng=np.random.default_rng(0))


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_where_a_run_tells_all_high_costs_are_compressed(sign):
    study, surrogates = models(sign, noise="none")
    model, low = surrogates.objective, np.quantile(cost(TRIED), 0.25)
    kept = [number not in surrogates.outliers for number in range(len(TRIED))]
    x, truth = TRIED[kept, None], cost(TRIED[kept])
    predicted, _ = model.predict(x)
    low_costs = truth <= low
    assert predicted[low_costs] == pytest.approx(truth[low_costs], abs=0.01)
    assert predicted.max() < 0.3 * truth.max()
    # Means are in the metric's unit whatever the scale.
    means = study.objective.from_cost(model.predict_mean(x))
    assert means == pytest.approx(sign * truth, rel=0.05, abs=0.01)
    assert model.compression.restore(predicted) == pytest.approx(sign * means)


def test_costs_with_noise_are_as_they_are():
    _, surrogates = models()
    assert surrogates.objective.compression is NO_COMPRESSION
