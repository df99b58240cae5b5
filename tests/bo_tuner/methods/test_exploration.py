"""When trials of `boundary` look elsewhere: only where no limit binds, and not at the end."""

from dataclasses import replace

import numpy as np
import pytest

from bo_tuner.methods.boundary.exploration import Exploration
from bo_tuner.methods.registry import METHODS
from bo_tuner.optimizers.base import SPACE_FILLING
from bo_tuner.tuning.driver import Driver
from bo_tuner.tuning.loop import Tuning

TRIALS = 20
PEAK = {"kind": "worst_case", "metric": "peak", "upper": 1.0}


def noisy(mean, seed):
    return mean * (1.0 + 0.02 * np.random.default_rng(seed).standard_normal())


def basin(peak):
    """A wide basin at 0.3, and a narrow one of half the cost at 0.85 of the parameter gain."""

    def run(gain, load, seed):
        cost = min(1.0 + (gain - 0.3) ** 2, 0.5 + 200.0 * (gain - 0.85) ** 2)
        return {"error": noisy(cost, seed), "peak": noisy(peak(gain), seed)}

    return run


@pytest.fixture
def origins(make_study, function_backend):
    def tune(peak, exploration=METHODS["boundary"].exploration):
        study = make_study(constraints={"peak": PEAK}).replace(trials=TRIALS)
        method = replace(METHODS["boundary"], exploration=exploration)
        trials = list(Tuning(study, Driver(function_backend(study, basin(peak))), method))
        return trials, [t.number for t in trials if t.origin == SPACE_FILLING]

    return tune


def free(gain):
    return 0.3


def test_where_no_limit_binds_trials_look_elsewhere(origins):
    trials, elsewhere = origins(free)
    assert elsewhere
    # None in the last fifth of the budget.
    assert max(elsewhere) < 0.8 * TRIALS
    best = min(trials, key=lambda t: np.mean(t.observations("error")))
    assert best.parameters["gain"] == pytest.approx(0.85, abs=0.05)


def test_each_is_in_the_middle_of_a_gap(origins):
    """Of 512 places: between two trials, or as far from one as from the end of the range."""
    trials, elsewhere = origins(free)
    gains = np.array([t.parameters["gain"] for t in trials])
    for number in elsewhere:
        apart = np.abs(gains[:number] - gains[number]).min()
        edges = np.sort([0.0, 1.0, *gains[:number]])
        assert apart > 0.4 * np.diff(edges)[1:-1].max()


def test_where_a_limit_binds_none_does(origins):
    """The least cost is beyond the limit, at a gain of 0.3; gains from 0.5 on keep it."""
    _, elsewhere = origins(lambda gain: 1.0 + 2.0 * (0.5 - gain))
    assert not elsewhere


def test_none_does_where_the_limits_are_expected_to_be_violated(origins):
    """Gains up to 0.5 keep the limit, which does not bind at 0.3."""
    trials, elsewhere = origins(lambda gain: 2.0 * gain)
    assert elsewhere
    assert all(trials[number].parameters["gain"] < 0.55 for number in elsewhere)


def test_without_exploration_none_does(origins):
    _, elsewhere = origins(free, Exploration(until=0.0))
    assert not elsewhere
