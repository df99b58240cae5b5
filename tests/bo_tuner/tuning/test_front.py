"""Runs with several objectives: a front that is known in closed form, under a robust limit.

With the context load from 1 to 2 and the limit slope x load <= 1, slope is at most 0.5. The errors

    near = (slope - 0.2)^2 + (gain - 0.5)^2,    far = (slope - 0.8)^2 + (gain - 0.5)^2

are smallest together for gain 0.5 and slope from 0.2 to 0.5, where sqrt(near) + sqrt(far) = 0.6.
The compromise with equal weights has slope 0.374: with u = slope - 0.2 the scaled errors are alike,
u^2 / 0.09 = ((0.6 - u)^2 - 0.09) / 0.27.
"""

from dataclasses import replace

import numpy as np
import pytest
import scipy.stats
from answering import recommend

from bo_tuner.evidence.differences import Change
from bo_tuner.evidence.limit_verdict import by_certificate
from bo_tuner.evidence.observed import Observed
from bo_tuner.evidence.quantities import quantities
from bo_tuner.methods.registry import METHODS
from bo_tuner.methods.stopping import StopAdvisor
from bo_tuner.optimizers.base import ACQUISITION
from bo_tuner.trials import ESTIMATING
from bo_tuner.tuning.driver import Driver
from bo_tuner.tuning.front import pareto_front
from bo_tuner.tuning.loop import Tuning
from tuning_benchmark.problems.two_objectives import hypervolume

NODE = {"node": "axis"}
SECTIONS = {
    "parameters": {
        name: NODE | {"type": "double", "bounds": [0.0, 1.0], "default": 0.45}
        for name in ("slope", "gain")
    },
    "metrics": {"near": NODE, "far": NODE, "peak": NODE},
    "objective": {"metric": "near"},
    "further_objectives": [{"metric": "far"}],
}
BUDGET = {"trials": 30, "initial_trials": 8, "drawn_contexts": 2, "search_evaluations": 3}
REFERENCE = np.array([0.1, 0.4])
COMPROMISE = 0.2 + (np.sqrt(1.44 + 2.16) - 1.2) / 4.0
VOLUME = 0.8 * 0.3**3 - 0.5 * 0.3**4 + (0.4 - 0.36) * 0.09 + (0.1 - 0.09) * (0.4 - 0.09)
"""Of the true front up to the reference: the integral over near, and two strips beyond its ends."""


def true(slope, gain):
    return (slope - 0.2) ** 2 + (gain - 0.5) ** 2, (slope - 0.8) ** 2 + (gain - 0.5) ** 2


def figures(slope, gain, load, seed):
    noise = 0.002 * np.random.default_rng(seed).normal(size=3)
    near, far = true(slope, gain)
    # The mean over the contexts is that of no single one.
    shift = 0.02 * (load - 1.5)
    return {
        "near": near + shift + noise[0],
        "far": far - shift + noise[1],
        "peak": slope * load + noise[2],
    }


@pytest.fixture(scope="module")
def study(make_study):
    return make_study(**SECTIONS).replace(**BUDGET)


@pytest.fixture(scope="module")
def run(study, function_backend):
    backend = function_backend(study, figures)
    trials = list(Tuning(study, Driver(backend), METHODS["IV"]))
    return trials, recommend(study, backend, trials)


def volume_of(trials, numbers):
    """Hypervolume of trials on the truth; those that violate the limit count nothing."""
    chosen = [trials[k].parameters for k in numbers]
    costs = [true(p["slope"], p["gain"]) for p in chosen if p["slope"] <= 0.5]
    return hypervolume(np.array(costs).reshape(-1, 2), REFERENCE)


def test_the_front_is_the_true_one(study, run):
    trials, found = run
    front = pareto_front(study, found.ranked)
    numbers = [point.trial for point in front]
    # Steps between the points cost some.
    assert volume_of(trials, numbers) > 0.85 * VOLUME
    # No volume is won by what breaks the limit.
    assert volume_of(trials, range(len(trials))) < VOLUME
    slopes = [trials[k].parameters["slope"] for k in numbers]
    assert max(slopes) < 0.52
    assert slopes == sorted(slopes)


def test_the_result_is_the_compromise(run):
    _, found = run
    assert found.feasible
    assert found.candidate.trial.parameters["slope"] == pytest.approx(COMPROMISE, abs=0.06)
    assert found.candidate.trial.parameters["gain"] == pytest.approx(0.5, abs=0.06)


def test_means_are_those_of_all_evaluations_in_drawn_contexts(study, run):
    _, found = run
    front = {point.trial: point for point in pareto_front(study, found.ranked)}
    point = front[found.candidate.trial.number]
    drawn = [
        e.outcome.metrics["far"] for e in found.candidate.trial.evaluations if e.stage in ESTIMATING
    ]
    assert point.means["far"].count == len(drawn) == 12
    assert point.means["far"].value == pytest.approx(np.mean(drawn))
    _, high = scipy.stats.t.interval(0.95, 11, np.mean(drawn), scipy.stats.sem(drawn))
    assert point.means["far"].error == pytest.approx(high - np.mean(drawn))


def test_a_resumed_run_repeats_the_rest(study, function_backend, run):
    trials, _ = run
    for count in (4, 11):
        backend = function_backend(study, figures)
        resumed = Tuning(study, Driver(backend), METHODS["IV"], trials=trials[:count])
        for trial in trials[count : count + 2]:
            assert next(iter(resumed)).parameters == trial.parameters


def test_directions_and_the_order_of_objectives(make_study, function_backend, run):
    """To maximize the negative is to minimize: all trials are the same."""
    study = make_study(
        **SECTIONS | {"further_objectives": [{"metric": "far", "direction": "maximize"}]}
    ).replace(**BUDGET | {"trials": 10})

    def mirrored(**values):
        found = figures(**values)
        return found | {"far": -found["far"]}

    trials = list(Tuning(study, Driver(function_backend(study, mirrored)), METHODS["IV"]))
    for here, there in zip(trials, run[0], strict=False):
        assert here.parameters == pytest.approx(there.parameters)
    points = pareto_front(study, METHODS["IV"].ranking.rank(study, trials))
    fars = [p.means["far"].value for p in points]
    assert fars == sorted(fars)


@pytest.mark.parametrize("algorithm", ["I", "II", "III", "V"])
def test_other_algorithms_can(study, function_backend, algorithm):
    small = study.replace(trials=11)
    backend = function_backend(small, figures)
    trials = list(Tuning(small, Driver(backend), METHODS[algorithm]))
    origins = {trial.origin for trial in trials[8:]}
    assert origins == ({"random"} if algorithm == "II" else {ACQUISITION})
    found = recommend(small, backend, trials, algorithm, most_checked=0)
    assert pareto_front(small, found.ranked)


def test_three_objectives(make_study, function_backend):
    sections = SECTIONS | {"further_objectives": [{"metric": "far"}, {"metric": "peak"}]}
    study = make_study(**sections).replace(**BUDGET | {"trials": 12})
    trials = list(Tuning(study, Driver(function_backend(study, figures)), METHODS["IV"]))
    points = pareto_front(study, METHODS["IV"].ranking.rank(study, trials))
    assert points
    assert set(points[0].means) == {"near", "far", "peak"}
    assert not [warning for trial in trials for warning in trial.warnings]


def test_there_is_no_advice_to_stop(study, run):
    advisor = StopAdvisor(study, METHODS["IV"])
    for count in range(1, len(run[0])):
        assert advisor.consider(run[0][:count]) is None


def test_the_verdict_knows_the_direction_of_each(study):
    draws = range(20)
    default, tuned = (
        Observed({k: {"near": near, "far": far, "peak": 0.5} for k in draws}, 20, [])
        for near, far in ((0.2, 0.1), (0.1, 0.2))
    )
    constraint = study.constraints["peak"]
    kept = by_certificate(study, constraint, passed=True, draws=20, violations=0)
    found = {
        q.metric: q.change
        for q in quantities(study, default, tuned, {}, {"peak": kept}, {})
        if q.difference is not None
    }
    assert found["near"] is Change.BETTER
    assert found["far"] is Change.WORSE


def test_trials_of_one_parameter_set_are_one_point(study, run):
    """In a space smaller than the budget; alone, the luckiest of them would be on the front."""
    trials, _ = run
    ranked = METHODS["IV"].ranking.rank(study, trials)
    on_front = {point.trial: point for point in pareto_front(study, ranked)}
    found = next(c for c in ranked if c.trial.number in on_front)
    twin = replace(found, trial=replace(found.trial, number=99))
    (point,) = pareto_front(study, [found, twin])
    assert point.trial == found.trial.number
    alone = on_front[found.trial.number].means
    for metric, mean in point.means.items():
        assert mean.count == 2 * alone[metric].count
        assert mean.value == pytest.approx(alone[metric].value)
