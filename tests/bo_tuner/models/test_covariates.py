"""Measured contexts in the models, against closed forms in which wind explains most of the noise.

error = (gain - 0.4)² + wind² with wind uniform in [0, 1], so its expectation has the wind's 1/3;
peak = 0.5 gain + load (1 + wind) / 2, so the mean over the wind is 0.5 gain + 0.75 load.
"""

import numpy as np
import pytest
from functions import make_study
from pooled_data import PLAIN

from bo_tuner.models.covariates import Covariates
from bo_tuner.models.pooled_models import PooledModels
from bo_tuner.models.pooled_process import PooledProcess
from bo_tuner.numerics.arrays import Array
from bo_tuner.trials import Evaluation, EvaluationState, Outcome, Stage, Trial, TrialState

NOISE = 0.02
NODE = {"node": "axis"}
METRICS = {"error": NODE, "peak": NODE, "wind": NODE | {"unit": "m/s"}}
GAINS = np.linspace(0.1, 0.9, 11)[:, None]


def study(**sections):
    peak = {"metric": "peak", "upper": 2.0}
    constraints = {
        "peak": peak | {"kind": "worst_case"},
        "run": peak | {"kind": "chance", "probability": 0.9},
    }
    return make_study(metrics=METRICS, constraints=constraints, **sections)


def error(gain, wind):
    return (gain - 0.4) ** 2 + wind**2


def peak(gain, load, wind):
    return 0.5 * gain + 0.5 * load * (1.0 + wind)


def runs(count=15, each=3, seed=1, wind=lambda rng: rng.random()):
    """Trials over the gains, with evaluations in random loads and winds."""
    rng = np.random.default_rng(seed)
    trials = []
    for number in range(count):
        parameters = {"gain": (number + 0.5) / count}
        evaluations = []
        for k in range(each):
            load, w = float(rng.uniform(1.0, 2.0)), float(wind(rng))
            noise = NOISE * rng.standard_normal(2)
            metrics = {
                "error": error(parameters["gain"], w) + noise[0],
                "peak": peak(parameters["gain"], load, w) + noise[1],
                "wind": w,
            }
            outcome = Outcome(EvaluationState.COMPLETE, metrics)
            evaluations.append(
                Evaluation(number, k, Stage.DRAWN, parameters, {"load": load}, k, outcome)
            )
        trials.append(Trial(number, parameters, "", TrialState.COMPLETE, "", tuple(evaluations)))
    return trials


def fitted(of_study, trials) -> object:
    return PooledModels()(of_study, trials, rng=np.random.default_rng(0))


class TestWindThatExplainsTheNoise:
    @pytest.mark.parametrize("seed", [1, 2, 3])
    def test_the_objective_is_known_better_with_it(self, seed):
        """Without it the spread of the wind's square, √(1/5 - 1/9) = 0.298, is noise."""
        trials = runs(seed=seed)
        without, knowing = fitted(study(), trials), fitted(study(measured=["wind"]), trials)
        noise = [np.sqrt(m.objective.noise_variance) for m in (without, knowing)]
        assert noise[0] == pytest.approx(0.298, rel=0.4)
        assert noise[1] < 3.0 * NOISE
        seen = np.mean([e.outcome.metrics["wind"] ** 2 for t in trials for e in t.evaluations])
        truth = (GAINS[:, 0] - 0.4) ** 2 + seen
        off = [np.abs(m.objective.predict_mean(GAINS) - truth).max() for m in (without, knowing)]
        assert off[1] < 0.02
        assert off[1] < 0.5 * off[0]

    def test_the_worst_case_is_over_the_load_and_the_mean_over_the_wind(self):
        """The worst load is 2, and the mean wind 0.5: 0.5 gain + 1.5, not 0.5 gain + 2."""
        models = fitted(study(measured=["wind"]), runs(30))
        row, mean, noise = models.constraints["peak"].worst_case(GAINS)
        contexts = models.constraints["peak"].contexts
        assert contexts.shape[1] == 1
        assert contexts[row, 0].min() > 0.9
        assert mean == pytest.approx(0.5 * GAINS[:, 0] + 1.5, abs=0.05)
        # A single run has the wind that it has: the spread of a uniform one is √(1/12).
        assert noise == pytest.approx(np.full(11, np.sqrt(1.0 / 12.0)), rel=0.2)

    def test_a_probability_is_over_both(self):
        of_study = study(measured=["wind"])
        models = fitted(of_study, runs(30))
        rng = np.random.default_rng(0)
        load, wind = rng.uniform(1.0, 2.0, 100_000), rng.random(100_000)
        truth = np.quantile(peak(0.5, load, wind), of_study.drawn_constraints[0].level)
        assert models.constraints["run"].predict_mean(np.array([[0.5]])) == pytest.approx(
            [truth], rel=0.04
        )

    def test_a_failed_run_has_measured_nothing_and_is_learnt_without(self):
        trials = runs(10)
        failed = Outcome(EvaluationState.FAILED, reason="axis: stalled")
        gone = Evaluation(10, 0, Stage.DRAWN, {"gain": 0.99}, {"load": 1.5}, 0, failed)
        trials.append(Trial(10, {"gain": 0.99}, "", TrialState.FAILED, "axis: stalled", (gone,)))
        models = fitted(study(measured=["wind"]), trials)
        near, far = models.crashes.probability(np.array([[0.99], [0.1]]))
        assert near > far

    def test_a_wind_that_never_changes_is_no_trouble(self):
        """error is (gain - 0.4)² + 0.09."""
        models = fitted(study(measured=["wind"]), runs(wind=lambda _: 0.3))
        assert models.objective.predict_mean(GAINS) == pytest.approx(
            (GAINS[:, 0] - 0.4) ** 2 + 0.09, abs=0.03
        )


class TestSeen:
    def rows(self, values: Array, count: int) -> Array:
        return Covariates(np.asarray(values, dtype=float)).rows(count)

    def test_are_quantiles_of_what_was_seen_within_its_range(self):
        """A skewed one: of the squares of 0 to 1 the quantiles are squares."""
        rows = self.rows((np.linspace(0.0, 1.0, 101) ** 2)[:, None], 5)
        assert rows[:, 0] == pytest.approx(np.array([0.1, 0.3, 0.5, 0.7, 0.9]) ** 2, abs=0.02)

    def test_what_was_measured_together_stays_together(self):
        wind = np.random.default_rng(0).permutation(50.0 + np.arange(50.0))
        rows = self.rows(np.column_stack([wind, -2.0 * wind]), 7)
        assert rows[:, 1] == pytest.approx(1.0 - rows[:, 0])

    def test_few_values_stand_for_more(self):
        assert sorted(self.rows([[3.0], [5.0]], 4)[:, 0]) == [0.0, 0.0, 1.0, 1.0]


class TestMeanOverColumns:
    """A process over (x, c, w), and its mean over rows of w, by its own predictions at these."""

    ROWS = np.array([[0.1], [0.5], [0.8]])
    CONTEXTS = np.array([[0.2], [0.9]])
    X = np.array([[0.15], [0.6], [0.85]])

    @pytest.fixture
    def process(self):
        rng = np.random.default_rng(4)
        x, c = rng.random((60, 1)), rng.random((60, 2))
        y = np.sin(3.0 * x[:, 0]) + c[:, 0] * c[:, 1] + 0.1 * rng.standard_normal(60)
        return PooledProcess.fit(x, c, y, coding=PLAIN, rng=rng)

    def joint(self, k):
        return np.hstack([np.tile(self.CONTEXTS[k], (3, 1)), self.ROWS])

    def test_mean_and_variance(self, process):
        mean = process.averaged(self.ROWS)
        for k in range(2):
            each = process.means(self.X, self.joint(k))
            assert mean.means(self.X, self.CONTEXTS)[:, k] == pytest.approx(each.mean(axis=1))
            variance = process.variance_of_mean(self.X, self.joint(k))
            assert mean.variances(self.X, self.CONTEXTS, np.full(3, k)) == pytest.approx(variance)

    def test_variance_of_means_and_sums_over_contexts(self, process):
        mean = process.averaged(self.ROWS)
        both = np.vstack([self.joint(0), self.joint(1)])
        assert mean.variance_of_mean(self.X, self.CONTEXTS) == pytest.approx(
            process.variance_of_mean(self.X, both)
        )
        weights = np.array([[0.3, 0.7]] * 3)
        assert mean.variance_of_weighted(self.X, self.CONTEXTS, weights) == pytest.approx(
            process.variance_of_weighted(self.X, both, np.repeat(weights, 3, axis=1) / 3.0)
        )

    def test_noise_of_a_run_has_the_spread_over_the_rows(self, process):
        mean = process.averaged(self.ROWS)
        everywhere, degrees = mean.noise_everywhere(self.X, self.CONTEXTS)
        for k in range(2):
            spread = process.means(self.X, self.joint(k)).var(axis=1)
            own = process.noise_everywhere(self.X, self.joint(k))[0]
            assert np.all(everywhere[:, k] >= spread + own.min(axis=1) - 1e-12)
            assert np.all(everywhere[:, k] <= spread + own.max(axis=1) + 1e-12)
            of_each = mean.noise(self.X, self.CONTEXTS, np.full(3, k))
            assert of_each[0] == pytest.approx(everywhere[:, k])
            assert of_each[1] == pytest.approx(degrees[:, k])
