import numpy as np
import pytest
from scipy.special import ndtri
from valley import Draws

from bo_tuner.errors import ParameterError
from bo_tuner.methods.registry import METHODS
from tuning_benchmark.paper.single_evaluations import single_evaluation_worst_cases
from tuning_benchmark.peers.adapter import PeerOptimizer, observation
from tuning_benchmark.peers.optimizer import Observation, best_observed


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


def test_an_observation_sums_up_the_evaluations(trial_study, make_trial):
    trial = make_trial(0, {"gain": 0.3}, errors=(1.0, 2.0, 4.0), worst=0.8, noise=0.1)
    quiet = make_trial(1, {"gain": 0.2}, errors=(1.0,), worst=0.1, noise=0.02)
    loud = make_trial(2, {"gain": 0.1}, errors=(1.0,), worst=0.1, noise=0.5)
    seen = observation(trial_study, trial, [trial, quiet, loud])
    assert seen.parameters == {"gain": 0.3}
    assert seen.objective == pytest.approx(np.log(2.0))
    # Half of three observations: the smallest value that at least half do not exceed.
    assert seen.constraints["often"] == pytest.approx(2.0 - 2.5)
    # The noise is the median of the three trials'.
    single_evaluation = 0.8 + 0.1 * ndtri(0.9)
    assert seen.constraints["peak"] == pytest.approx(single_evaluation - 1.0)


def test_a_crash_has_no_values(trial_study, make_trial):
    crashed = make_trial(0, {"gain": 0.3})
    seen = observation(trial_study, crashed, [crashed])
    assert seen.failed
    assert (seen.objective, dict(seen.constraints)) == (None, {})


def test_an_optimizer_sees_what_our_surrogates_see(trial_study, make_trial):
    trials = [
        make_trial(k, {"gain": 0.1 * k}, errors=(1.0, 1.1), worst=0.1 * k, noise=0.01 * (k % 3))
        for k in range(6)
    ]
    (limit,) = trial_study.worst_case_constraints
    seen = [observation(trial_study, t, trials).constraints["peak"] + limit.upper for t in trials]
    assert seen == pytest.approx(single_evaluation_worst_cases(trials, limit).tolist())


def test_the_initial_design_is_the_tuners(trial_study, make_trial):
    optimizer = Draws(trial_study, 5)
    trials = []
    asked, ours = PeerOptimizer(trial_study, optimizer), METHODS["IV"].optimizer(trial_study)
    for number in range(trial_study.budget.initial_trials):
        proposal = asked.ask()
        assert proposal.parameters == ours.ask().parameters
        trial = make_trial(number, proposal.parameters, errors=(1.0, 1.2), worst=0.5, noise=0.1)
        trials.append(trial)
        asked.tell(trial)
        ours.tell(trial)
    # Told all at once: each with the noise of all.
    assert optimizer.told == []
    assert asked.recommend() == best_observed([observation(trial_study, t, trials) for t in trials])
    alone = Draws(trial_study, 5).ask()
    assert asked.ask().parameters == alone
    assert optimizer.told == [observation(trial_study, t, trials) for t in trials]


def test_an_asked_value_stays_to_the_last_digit(make_study, make_trial):
    """Some optimizers look for what they asked among what they are told."""
    study = make_study(
        parameters={"x": {"node": "axis", "type": "double", "bounds": [-5, 1], "default": 0}}
    )
    # Through the cube and back it is rounded to the resolution of its range.
    space, value = study.search_space(), 0.123456789012345
    assert space.to_parameters(space.to_cube({"x": value}))["x"] != value

    class Fixed(Draws):
        def ask(self):
            return {"x": value}

    asked = PeerOptimizer(study, Fixed(study, 1))
    for number in range(study.budget.initial_trials):
        asked.tell(make_trial(number, asked.ask().parameters, errors=(1.0,)))
    assert asked.ask().parameters["x"] == value


def test_what_lies_outside_the_space_is_refused(trial_study, make_trial):
    class Outside(Draws):
        def ask(self):
            return {"gain": 1.5}

    asked = PeerOptimizer(trial_study, Outside(trial_study, 1))
    for number in range(trial_study.budget.initial_trials):
        asked.tell(make_trial(number, asked.ask().parameters, errors=(1.0,)))
    with pytest.raises(ParameterError, match="gain"):
        asked.ask()


def test_the_best_observed_is_feasible():
    def observe(objective, peak):
        return Observation({}, False, objective, {"peak": peak})

    seen = [Observation({}, True, None, {}), observe(1.0, 0.1), observe(3.0, -0.1), observe(2.0, 0)]
    assert best_observed(seen) == 3
    assert best_observed(seen[:2]) is None
