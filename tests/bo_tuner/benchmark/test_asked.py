import numpy as np
import pytest
from scipy.special import ndtri
from valley import Draws

from bo_tuner.benchmark.asked import AskedStageOne, observation
from bo_tuner.errors import ParameterError
from bo_tuner.stage_one import BayesianOptimization


@pytest.fixture
def trial_study(make_study):
    node = {"node": "axis"}
    return make_study(
        metrics={"error": node, "peak": node},
        objective={"metric": "error", "scale": "log"},
        constraints={
            "peak": {"kind": "worst_case", "metric": "peak", "upper": 1.0, "probability": 0.9},
            "often": {"kind": "chance", "metric": "error", "upper": 2.5, "probability": 0.5},
        },
    )


def test_an_observation_sums_up_the_cuts(trial_study, make_trial):
    trial = make_trial(0, {"gain": 0.3}, errors=(1.0, 2.0, 4.0), worst=0.8, noise=0.1)
    seen = observation(trial_study, trial)
    logs = np.log([1.0, 2.0, 4.0])
    assert seen.parameters == {"gain": 0.3}
    assert seen.objective == pytest.approx(np.log(2.0))
    assert seen.standard_error == pytest.approx(logs.std(ddof=1) / np.sqrt(3.0))
    # Half of three observations: the smallest value that at least half do not exceed.
    assert seen.constraints["often"] == pytest.approx(2.0 - 2.5)
    single_cut = 0.8 + 0.1 * ndtri(0.9)
    assert seen.constraints["peak"] == pytest.approx(single_cut - 1.0)


def test_a_crash_has_no_values(trial_study, make_trial):
    seen = observation(trial_study, make_trial(0, {"gain": 0.3}))
    assert seen.failed
    assert (seen.objective, seen.standard_error, dict(seen.constraints)) == (None, None, {})


def test_one_cut_has_no_standard_error(trial_study, make_trial):
    assert (
        observation(trial_study, make_trial(0, {"gain": 0.3}, errors=(1.0,))).standard_error is None
    )


def test_the_initial_design_is_the_products(trial_study, make_trial):
    optimizer = Draws(trial_study, 5)
    asked, ours = AskedStageOne(trial_study, optimizer), BayesianOptimization(trial_study)
    for number in range(trial_study.budget.initial_trials):
        proposal = asked.ask()
        assert proposal.parameters == ours.ask().parameters
        trial = make_trial(number, proposal.parameters, errors=(1.0, 1.2))
        asked.tell(trial)
        ours.tell(trial)
    assert len(optimizer.told) == trial_study.budget.initial_trials
    alone = Draws(trial_study, 5).ask()
    assert asked.ask().parameters == pytest.approx(alone)


def test_what_lies_outside_the_space_is_refused(trial_study, make_trial):
    class Outside(Draws):
        def ask(self):
            return {"gain": 1.5}

    asked = AskedStageOne(trial_study, Outside(trial_study, 1))
    for number in range(trial_study.budget.initial_trials):
        asked.tell(make_trial(number, asked.ask().parameters, errors=(1.0,)))
    with pytest.raises(ParameterError, match="gain"):
        asked.ask()
