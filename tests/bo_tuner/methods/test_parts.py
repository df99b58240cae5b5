"""Parts of a method that are replaced: they take effect wherever the method uses them."""

from dataclasses import replace

import numpy as np
import pytest

from bo_tuner.methods.boundary.settling import Repetitions
from bo_tuner.methods.registry import METHODS
from bo_tuner.models.categories import Coding
from bo_tuner.models.compression import Compression
from bo_tuner.models.pooled_models import PooledModels
from bo_tuner.models.pooled_process import PooledProcesses
from bo_tuner.tuning.loop import Tuning
from bo_tuner.tuning.summary import choose_answer

BOUNDARY = METHODS["boundary"]


def slope(gain, load, seed):
    """The limit, 1, is kept under the largest load up to a gain of 0.5."""
    noise = np.random.default_rng(seed).normal(0.0, 0.01)
    return {"error": 2.0 - gain, "peak": 0.5 + 0.5 * gain * load + noise}


@pytest.fixture
def study(make_study):
    return make_study().replace(trials=8, initial_trials=4)


def test_with_a_wide_kernel_the_noise_is_the_same_everywhere():
    rng = np.random.default_rng(0)
    x, c = rng.random((300, 1)), rng.random((300, 1))
    y = np.where(c[:, 0] > 0.5, 0.3, 0.03) * rng.standard_normal(300)
    ends = np.array([[0.05], [0.95]])
    ratio = {}
    for width in (0.2, 1e3):
        process = PooledProcesses(width=width).fit(x, c, y, coding=Coding((0,)), rng=rng)
        ((calm, loud),) = process.noise_everywhere(np.array([[0.5]]), ends)[0]
        ratio[width] = loud / calm
    assert ratio[0.2] > 10.0
    assert ratio[1e3] == pytest.approx(1.0, abs=1e-3)


def test_the_scale_of_limited_metrics_is_that_of_both_stages(study, function_backend):
    """It is chosen by as many values as there are, in the models and in each search."""
    asked = []

    def scale(y, limit, sign):
        asked.append(len(y))
        return Compression(limit, sign)

    method = replace(BOUNDARY, models=PooledModels(scale=scale))
    trials = list(Tuning(study, function_backend(study, slope), method))
    before = np.cumsum([0, *(len(trial.evaluations) for trial in trials)])[:-1].tolist()
    # The initial trials are proposed without models, but searched like all others.
    assert asked == before[:4] + [count for count in before[4:] for _ in range(2)]


def test_contexts_that_are_looked_at_are_candidates_for_the_worst(make_study, function_backend):
    variable = {"node": "axis", "distribution": "uniform", "bounds": [1.0, 2.0]}
    study = make_study(contexts=dict.fromkeys(("load", "heat", "wear"), variable)).replace(
        trials=4, initial_trials=4, search_evaluations=0
    )
    backend = function_backend(study, lambda gain, load, seed, **_: slope(gain, load, seed))
    trials = list(Tuning(study, backend, BOUNDARY))
    middle = {"load": 1.5, "heat": 1.5, "wear": 1.5}
    without, with_one = (
        PooledModels(looked=lambda _, known=known: known)(
            study, trials, rng=np.random.default_rng(0)
        )
        .constraints["peak"]
        .contexts
        for known in ((), (middle,))
    )
    np.testing.assert_array_equal(with_one, np.vstack([without, [[0.5, 0.5, 0.5]]]))


def test_the_largest_probability_of_a_failure_is_asked_for_each_proposal(study, function_backend):
    asked = []

    def avoidance(study, trials):
        asked.append(len(trials))
        return 1.0

    method = replace(BOUNDARY, avoidance=avoidance)
    list(Tuning(study, function_backend(study, slope), method))
    assert sorted(set(asked)) == [4, 5, 6, 7]


def test_a_share_of_nothing_leaves_all_evaluations_to_the_trials(study, function_backend):
    method = replace(BOUNDARY, repetitions=Repetitions(share=0.0))
    assert method.within(study, 100, reserved=40) == (method, 100)
    backend = function_backend(study, slope)
    trials = list(Tuning(study, backend, method))
    runs = len(backend.calls)
    assert choose_answer(study, backend, method, trials).checked == ()
    assert len(backend.calls) == runs
