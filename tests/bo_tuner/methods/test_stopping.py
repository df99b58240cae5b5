"""The advice to stop: its numbers against a dense search, and when it is given."""

import json
import signal

import numpy as np
import pytest
from axis import node
from command_runs import Runs
from scipy.stats import norm

from bo_tuner.methods.outlook import Outlook
from bo_tuner.methods.registry import METHODS
from bo_tuner.methods.stopping import StopAdvisor
from bo_tuner.numerics.particle_swarm import maximize
from bo_tuner.storage.journal_reader import read_journal
from bo_tuner.storage.session_options import options_of
from bo_tuner.tuning.driver import Driver
from bo_tuner.tuning.loop import Tuning
from tuning_benchmark.paper.method import PaperMethod

ALGORITHM, BOUNDARY = METHODS["IV"], METHODS["boundary"]
BUDGET = {
    "trials": 40,
    "initial_trials": 8,
    "drawn_contexts": 5,
    "search_evaluations": 0,
    "validation_draws": 5,
}


@pytest.fixture
def run(make_study, function_backend):
    """Function that tunes an objective of parameters in [0, 1]; yields the trials so far.

    The load, uniform in [1, 2], adds noise of the given standard deviation.
    """

    def start(objective, noise, parameters=1, algorithm=ALGORITHM, **budget):
        numeric = {"node": "axis", "type": "double", "bounds": [0.0, 1.0], "default": 0.5}
        study = make_study(
            parameters={f"gain_{k}": numeric for k in range(parameters)}, budget=BUDGET | budget
        )

        def function(load, seed, **gains):
            error = objective(np.array(list(gains.values())))
            return {"error": error + noise * (load - 1.5) * 12**0.5, "peak": 0.2}

        tuning = Tuning(study, Driver(function_backend(study, function)), algorithm)
        return study, (tuning.trials for _ in tuning)

    return start


def until_advice(study, steps, algorithm=ALGORITHM):
    """The trials up to the advice, or all of them; and the advice."""
    advisor = StopAdvisor(study, algorithm)
    for trials in steps:
        if advisor.consider(trials) is not None:
            break
    return trials, advisor.advice


def distance(gains):
    return float(20 * np.sum((gains - np.linspace(0.3, 0.7, len(gains))) ** 2))


class TestAdvice:
    def test_where_all_are_equal_there_is_nothing_to_gain(self, run):
        study, steps = run(lambda gains: 5.0, noise=0.3)
        _, advice = until_advice(study, steps)
        assert advice is not None
        assert advice.trials + advice.remaining == 40
        # The standard error of five evaluations; drawn by quantiles they vary a little less.
        assert advice.noise == pytest.approx(0.3 / 5**0.5, rel=0.15)
        assert advice.expected_gain < advice.noise

    def test_a_known_optimum_was_found_to_the_noise(self, run):
        study, steps = run(distance, noise=0.3)
        trials, advice = until_advice(study, steps)
        assert advice is not None
        best = min(distance(np.array([t.parameters["gain_0"]])) for t in trials)
        assert best < advice.noise

    def test_there_is_none_as_long_as_much_is_left_to_gain(self, run):
        """Five parameters without noise: it takes more than 25 trials to come near the optimum."""
        study, steps = run(distance, noise=1e-3, parameters=5, trials=26)
        trials, advice = until_advice(study, steps)
        left = min(distance(np.array(list(t.parameters.values()))) for t in trials)
        assert left > 1e-2
        assert advice is None

    def test_with_pooled_evaluations(self, run):
        """Where all are equal: the error is that of a run in a drawn context, over all its runs."""
        study, steps = run(lambda gains: 5.0, noise=0.3, algorithm=BOUNDARY)
        trials, advice = until_advice(study, steps, BOUNDARY)
        assert advice is not None
        assert advice.trials < 40
        (answer, *_) = BOUNDARY.ranking.rank(study, trials)
        expected = 0.3 / len(answer.trial.evaluations) ** 0.5
        assert advice.noise == pytest.approx(expected, rel=0.15)
        assert advice.expected_gain < advice.noise

    def test_none_with_pooled_evaluations_as_long_as_much_is_left_to_gain(self, run):
        study, steps = run(distance, noise=1e-3, parameters=5, algorithm=BOUNDARY, trials=20)
        advisor = StopAdvisor(study, BOUNDARY)
        seen = []
        for trials in steps:
            assert advisor.consider(trials) is None
            if len(trials) in (10, 15):
                seen.append((20 - len(trials), BOUNDARY.outlook(study, trials)))
        for remaining, found in seen:
            assert remaining * found.gain > found.noise

    def test_none_for_random_search_and_none_after_the_last_trial(self, run):
        study, steps = run(lambda gains: 5.0, noise=0.3, trials=10)
        assert until_advice(study, steps)[1] is None
        study, steps = run(lambda gains: 5.0, noise=0.3, trials=25)
        trials = list(list(steps)[-1])
        random = StopAdvisor(study, METHODS["II"])
        assert not any(random.consider(trials[:n]) for n in range(1, 25))

    @pytest.mark.parametrize("direction", ["minimize", "maximize"])
    def test_on_a_log_scale_it_holds_in_the_unit_of_the_metric_too(
        self, make_study, make_trial, monkeypatch, direction
    ):
        objective = {"metric": "error", "scale": "log", "direction": direction}
        study = make_study(objective=objective, budget=BUDGET)
        cost = float(study.objective.to_cost(10.0))
        monkeypatch.setattr(PaperMethod, "outlook", lambda *_: Outlook(cost, 0.016, 0.5))
        trials = [make_trial(k, {"gain": 0.5}, [10.0]) for k in range(40)]
        _, advice = until_advice(study, (trials[:count] for count in range(1, 16)))
        assert advice.remaining == 25
        assert advice.expected_gain < advice.noise
        assert advice.noise == pytest.approx(10.0 * np.expm1(0.5))

    def test_none_while_nothing_is_feasible(self, make_study, make_trial):
        study = make_study(budget=BUDGET)
        rng = np.random.default_rng(1)
        trials = [
            make_trial(k, {"gain": g}, rng.normal(1.0, 0.1, 5).tolist(), worst=5.0)
            for k, g in enumerate(rng.random(12))
        ]
        assert ALGORITHM.outlook(study, trials) is None
        assert BOUNDARY.outlook(study, trials) is None
        assert ALGORITHM.outlook(study, [make_trial(0, {"gain": 0.5})]) is None


def test_the_gain_is_the_largest_improvement_on_a_dense_grid(make_study, make_trial):
    """With the same models; improvement, its maximum and the noise are computed independently."""
    study = make_study(budget=BUDGET)
    rng = np.random.default_rng(3)
    trials = [
        make_trial(
            k, {"gain": g}, (np.sin(9 * g) + rng.normal(0.0, 0.02, 5)).tolist(), worst=0.5 + 0.7 * g
        )
        for k, g in enumerate(np.linspace(0.02, 0.98, 7))
    ]
    found = ALGORITHM.outlook(study, trials)
    models = ALGORITHM.models(study, trials, rng=np.random.default_rng(0))
    grid = np.linspace(0.0, 1.0, 20001)[:, None]

    def probability(x):
        (constraint,) = models.constraints.values()
        mean, variance = constraint.predict(x)
        return norm.cdf((1.0 - mean) / np.sqrt(variance))

    points = models.objective.points
    mean, _ = models.objective.predict(points)
    best = mean[probability(points) >= 0.5].min()
    mean, variance = models.objective.predict_reinterpolated(grid)
    sd = np.sqrt(np.maximum(variance, 1e-300))
    z = (best - mean) / sd
    improvement = np.where(variance > 0, (best - mean) * norm.cdf(z) + sd * norm.pdf(z), 0.0)
    gain = (improvement * probability(grid)).max()
    assert found.incumbent == pytest.approx(best, abs=1e-3)
    # Both fits are local searches from starts of their own.
    assert found.gain == pytest.approx(gain, rel=0.05)
    assert found.noise == pytest.approx((models.objective.noise_variance / 5) ** 0.5, rel=0.05)


STOP = ("--stop-early",)


@pytest.fixture(scope="module")
def runs(tmp_path_factory, make_study):
    """Of an object for which all parameter sets are equal."""
    study = make_study(nodes=node("flat_axis"), budget=BUDGET)
    return Runs(tmp_path_factory.mktemp("flat"), study, error="5.0 + self.load")


@pytest.fixture(scope="module")
def whole(runs):
    """A run that nothing disturbed, and its folder."""
    code, _, err = runs.begin("whole", *STOP)
    assert code == 0, err
    return err, runs.folder / "whole" / "latest"


class TestStopEarly:
    def test_ends_the_tuning_but_not_the_run(self, whole):
        err, folder = whole
        summary = json.loads((folder / "summary.json").read_text())
        advice = summary["stop_advice"]
        content = read_journal(folder / "journal.sqlite")
        assert summary["stopped_early"] is True
        assert len(content.trials) == advice["trials"] < 40
        assert options_of(content.sessions[0]).stop_early
        assert "advice: stop here; " in err
        assert summary["checked_trials"]
        assert summary["tuned"]["draws"] == 5

    @pytest.mark.parametrize("moment", [0.6, 0.9])
    def test_a_resumed_run_decides_the_same(self, runs, whole, moment):
        """The option is on record. First before the end of the tuning, then after it."""
        _, folder = whole
        evaluations = len(read_journal(folder / "journal.sqlite").evaluations)
        name = f"killed-{moment}"
        code, _, _ = runs.begin(name, *STOP, kill=round(moment * evaluations))
        assert code == -signal.SIGKILL
        code, _, err = runs.resume(name)
        assert code == 0, err
        assert runs.results(name) == runs.results("whole")


def test_advice_and_optimizer_start_their_search_from_the_feasible_points(
    make_study, make_trial, monkeypatch
):
    """Below 0.5 the cost is low and the limit violated, so what is promising lies above."""
    study = make_study(budget=BUDGET | {"initial_trials": 12})
    trials = [
        make_trial(k, {"gain": g}, [1.0 + g, 1.01 + g], worst=1.5 - g)
        for k, g in enumerate(np.linspace(0.02, 0.98, 12))
    ]
    seen = []

    def keep(acquisition, dimension, rng, *, initial=None, **options):
        seen.append(initial)
        return maximize(acquisition, dimension, rng, initial=initial, **options)

    monkeypatch.setattr("bo_tuner.optimizers.bayesian.maximize", keep)
    optimizer = ALGORITHM.optimizer(study)
    for trial in trials:
        optimizer.tell(trial)
    optimizer.ask()
    by_optimizer, seen[:] = seen[0], []
    ALGORITHM.outlook(study, trials)
    (by_advice,) = seen
    for starts in (by_optimizer, by_advice):
        # The six feasible points come first, each moved by 0.05 on average.
        assert np.sort(starts[:6, 0]) == pytest.approx(np.linspace(0.54, 0.98, 6), abs=0.2)
