"""Objectives and limits by processes over parameter set and context, against closed forms."""

import numpy as np
import pytest
from pooled_data import CORNERS, PLAIN, fitted, scattered
from scipy.stats import norm

from bo_tuner.models.pooled_process import PooledProcess
from bo_tuner.models.pooled_responses import (
    EveryContext,
    ExpectedObjective,
    FutureBound,
    OverContexts,
    PooledResponse,
)
from bo_tuner.study.context_space import ContextSpace
from bo_tuner.study.distributions import Uniform
from bo_tuner.study.parts import Objective


class TestExpectedObjective:
    """log C = 0.5 + x + c + noise with c uniform in [0, 1], so E[C] is in closed form."""

    NOISE = 0.2

    def expected(self, sign):
        rng = np.random.default_rng(0)
        x, c = rng.random((300, 1)), rng.random((300, 1))
        log = 0.5 + x[:, 0] + c[:, 0] + self.NOISE * rng.standard_normal(300)
        objective = Objective(
            metric="C", scale="log", direction="minimize" if sign > 0 else "maximize"
        )
        contexts = ContextSpace({"c": Uniform(bounds=(0.0, 1.0))})
        drawn = contexts.draw_stratified(256, np.random.default_rng(1))
        process = fitted(x, c, objective.to_cost(np.exp(log)))
        return ExpectedObjective(process, contexts.to_cube(drawn), objective), objective

    @pytest.mark.parametrize("sign", [1, -1])
    def test_is_that_of_the_metric_not_of_its_logarithm(self, sign):
        model, objective = self.expected(sign)
        x = np.array([[0.2], [0.5], [0.8]])
        truth = np.exp(0.5 + x[:, 0]) * (np.e - 1.0) * np.exp(0.5 * self.NOISE**2)
        mean, variance = model.predict(x)
        assert objective.from_cost(mean) == pytest.approx(truth, rel=0.05)
        assert np.sqrt(variance).max() < 0.05
        # The mean of the logarithm is 4.1 % and the noise 2 % lower.
        assert objective.from_cost(mean) == pytest.approx(model_of_samples(model, x), rel=0.05)

    def test_on_a_linear_scale(self):
        x, c, y = scattered(200)
        model = ExpectedObjective(fitted(x, c, y), CORNERS, Objective(metric="C"))
        mean, _ = model.predict(np.array([[0.4]]))
        assert mean == pytest.approx([0.4 + (0.0 + 0.25 + 1.0) / 3.0], abs=0.02)

    def test_reinterpolated_where_it_was_evaluated(self):
        x, c, y = scattered(50)
        model = ExpectedObjective(fitted(x, c, y), CORNERS, Objective(metric="C"))
        _, variance = model.predict_reinterpolated(np.vstack([x[:1], [[0.123456]]]))
        assert variance[0] == 0.0
        assert variance[1] > 0.0


def model_of_samples(model, x):
    """The expectation by draws of the latent process of each context."""
    rng = np.random.default_rng(2)
    means = model.process.means(x, model.contexts) * model.objective.sign
    noise = np.sqrt(model.process.noise_variance) * rng.standard_normal((200, *means.shape))
    return np.exp(means + noise).mean(axis=(0, 2))


class TestEveryContext:
    def test_is_the_worst_case(self):
        """The worst of x + c² is x + 1."""
        constraint = EveryContext(fitted(*scattered(150)), 1.5, CORNERS)
        x = np.linspace(0.0, 1.0, 9)[:, None]
        mean, variance = constraint.predict(x)
        assert mean == pytest.approx(x[:, 0] + 1.0, abs=0.03)
        probability = np.exp(constraint.log_probability(x))
        assert probability[x[:, 0] < 0.45].min() > 0.95
        assert probability[x[:, 0] > 0.55].max() < 0.05
        assert variance.max() < 0.03**2

    def test_a_run_keeps_its_distance_by_the_noise_of_that_context(self):
        process = fitted(*scattered(400, sd=lambda c: 0.01 if c < 0.5 else 0.05))
        x = np.array([[0.5]])
        of_mean = EveryContext(process, 1.5, CORNERS)
        of_runs = EveryContext(process, 1.5, CORNERS, float(norm.ppf(0.9)))
        margin = of_runs.predict(x)[0] - of_mean.predict(x)[0]
        assert margin == pytest.approx([norm.ppf(0.9) * 0.05], rel=0.3)
        assert of_runs.predict(x)[1] > of_mean.predict(x)[1]

    @pytest.mark.parametrize("sign", [1.0, -1.0])
    def test_the_worst_context_of_runs_is_that_of_their_quantile(self, sign):
        """Of x - 0.2 c with noise of 0.01 up to c = 0.5 and 0.3 beyond, c = 0 has the worst mean.

        The 95 % quantile is x + 0.02 there, and x - 0.2 + 1.645 · 0.3 = x + 0.29 at c = 1.
        """
        x, c, _ = scattered(600)
        noise = np.where(c[:, 0] > 0.5, 0.3, 0.01) * np.random.default_rng(5).normal(size=600)
        process = fitted(x, c, sign * (x[:, 0] - 0.2 * c[:, 0] + noise))
        at, ends = np.array([[0.3], [0.6]]), CORNERS[::2]
        of_mean = EveryContext(process, sign, ends, sign=sign)
        assert of_mean.worst_case(at)[0].tolist() == [0, 0]
        of_runs = EveryContext(process, sign, ends, float(norm.ppf(0.95)), sign=sign)
        rows, mean, deviation = of_runs.worst_case(at)
        assert rows.tolist() == [1, 1]
        assert sign * mean == pytest.approx(at[:, 0] - 0.2, abs=0.1)
        assert deviation == pytest.approx(0.3, rel=0.2)
        assert sign * of_runs.predict_mean(at) == pytest.approx(at[:, 0] + 0.29, abs=0.15)
        # What the limit is judged by is what is predicted.
        doubtful, probability = of_runs.most_doubtful(at)
        assert doubtful.tolist() == [1, 1]
        assert of_runs.log_kept(*of_runs.predict(at)) == pytest.approx(probability)

    @pytest.mark.parametrize("sign", [1.0, -1.0])
    def test_is_within_the_responses_on_the_good_side(self, sign):
        """The slope goes on beyond the data, where the metric is at its bound."""
        x = np.linspace(0.5, 1.0, 6)[:, None]
        process = fitted(x, np.empty((6, 0)), sign * (x[:, 0] - 0.5))
        everywhere = EveryContext(process, sign * 0.3, np.empty((1, 0)), sign=sign)
        points = np.array([[0.3], [0.9]])
        assert (sign * process.means(points, np.empty((1, 0))))[0, 0] < -0.05
        _, worst, _ = everywhere.worst_case(points)
        assert worst == pytest.approx([0.0, sign * 0.4], abs=0.01)

    def test_the_most_doubtful_context_counts(self):
        """No run was in the upper half of the contexts: nothing is shown there."""
        x, c, y = scattered(100)
        constraint = EveryContext(fitted(x, 0.5 * c, y), 3.0, CORNERS)
        at = np.array([[0.5]])
        alone = EveryContext(constraint.process, 3.0, CORNERS[:1])
        least = constraint.least_log_probability(at)
        assert least < alone.least_log_probability(at)
        each = [
            EveryContext(constraint.process, 3.0, CORNERS[k : k + 1]).log_probability(at)
            for k in range(3)
        ]
        assert least == pytest.approx(np.min(each, axis=0))


class TestChance:
    """Quantile of runs over contexts and noise, against a closed form and sampling."""

    def process(self, rng, noise=0.1, slope=1.0):
        x, c = rng.random((150, 1)), rng.random((150, 1))
        y = x[:, 0] + slope * c[:, 0] + rng.normal(0.0, noise, 150)
        return PooledProcess.fit(x, c, y, coding=PLAIN, rng=rng)

    def constraint(self, process, probability, **changes):
        contexts = (np.arange(64)[:, None] + 0.5) / 64
        return OverContexts(process, 1.5, contexts, probability, **changes)

    @pytest.mark.parametrize("probability", [0.6, 0.9])
    def test_is_that_of_the_sum_of_context_and_noise(self, probability):
        """y = x + c + n with c uniform; the quantile of c + n is found by sampling."""
        rng = np.random.default_rng(0)
        process = self.process(rng)
        x = np.array([[0.2], [0.7]])
        quantile, variance = self.constraint(process, probability).predict(x)
        runs = rng.random(400_000) + rng.normal(0.0, 0.1, 400_000)
        expected = x[:, 0] + np.quantile(runs, probability)
        assert quantile == pytest.approx(expected, abs=0.03)
        assert np.all((variance > 0.0) & (variance < 0.03**2))

    def test_the_quantile_alone(self):
        constraint = self.constraint(self.process(np.random.default_rng(4)), 0.9, sign=-1.0)
        x = np.array([[0.2], [0.7]])
        quantile, _ = constraint.predict(x)
        assert constraint.predict_mean(x) == pytest.approx(quantile, rel=1e-12)

    def test_of_a_lower_limit_is_the_mirror_image(self):
        process = self.process(np.random.default_rng(1))
        x = np.array([[0.4]])
        (upper,), _ = self.constraint(process, 0.9).predict(x)
        (lower,), _ = self.constraint(process, 0.9, sign=-1.0).predict(x)
        # Uniform context and normal noise are symmetric about x + 0.5.
        assert upper - 0.9 == pytest.approx(0.9 - lower, abs=0.03)

    def test_without_influence_of_the_context_is_that_of_a_run(self):
        process = self.process(np.random.default_rng(2), slope=0.0)
        x = np.array([[0.5]])
        (quantile,), _ = self.constraint(process, 0.9).predict(x)
        assert quantile == pytest.approx(0.5 + 0.1 * norm.ppf(0.9), abs=0.03)

    def test_variance_of_equal_weights_is_that_of_the_mean(self):
        process = self.process(np.random.default_rng(3))
        x, contexts = np.array([[0.3], [0.9]]), np.linspace(0.0, 1.0, 7)[:, None]
        weights = np.full((2, 7), 1.0 / 7.0)
        assert process.variance_of_weighted(x, contexts, weights) == pytest.approx(
            process.variance_of_mean(x, contexts)
        )

    def test_noise_everywhere_is_that_of_each_context(self):
        process = self.process(np.random.default_rng(4))
        x, contexts = np.array([[0.3], [0.9]]), np.array([[0.1], [0.8]])
        variance, degrees = process.noise_everywhere(x, contexts)
        for column in range(2):
            expected = process.noise(x, contexts, np.full(2, column))
            assert variance[:, column] == pytest.approx(expected[0])
            assert degrees[:, column] == pytest.approx(expected[1])

    def test_without_noise(self):
        process = self.process(np.random.default_rng(5), noise=0.0)
        (quantile,), _ = self.constraint(process, 0.9).predict(np.array([[0.5]]))
        assert quantile == pytest.approx(1.4, abs=0.03)

    def test_a_run_tells_as_much_as_in_an_estimate_from_runs(self):
        """Against the spread of mean + z · standard deviation of 200 runs, by sampling."""
        rng = np.random.default_rng(6)
        constraint = self.constraint(self.process(rng, slope=0.2), 0.9)
        runs = 0.2 * rng.random((4000, 200)) + rng.normal(0.0, 0.1, (4000, 200))
        estimates = runs.mean(axis=1) + norm.ppf(0.9) * runs.std(axis=1, ddof=1)
        _, _, (variance,) = constraint.forecast(np.array([[0.5]]))
        assert variance == pytest.approx(200.0 * estimates.var(), rel=0.35)


class Known(PooledResponse):
    """A response of which mean, variance and that of a run are given."""

    def __init__(self, limit, sign, mean, variance, run):
        self.limit, self.sign = limit, sign
        self._mean, self._variance, self._run = mean, variance, run

    def on_runs(self, level):
        return self

    def predict(self, x):
        return self.forecast(x)[:2]

    def forecast(self, x):
        return tuple(np.full(len(x), v) for v in (self._mean, self._variance, self._run))

    def deviation_of_run(self, x):
        return np.full(len(x), self._run**0.5)


class TestFutureBound:
    @pytest.mark.parametrize(("limit", "sign"), [(1.3, 1.0), (1.0, 1.0), (0.7, -1.0)])
    @pytest.mark.parametrize("runs", [1, 8])
    def test_is_how_often_runs_show_that_the_limit_is_kept(self, limit, sign, runs):
        """Draw the truth, then runs of it; judge by the conjugate posterior of a normal mean."""
        mean, variance, run, confidence = 1.0, 0.04, 0.09, 0.9
        rng = np.random.default_rng(runs)
        truth = rng.normal(mean, np.sqrt(variance), 200_000)
        average = rng.normal(truth, np.sqrt(run / runs))
        precision = 1.0 / variance + runs / run
        posterior = (mean / variance + runs * average / run) / precision
        shown = norm.cdf(sign * (limit - posterior) * np.sqrt(precision)) >= confidence
        bound = FutureBound(Known(limit, sign, mean, variance, run), runs, confidence)
        (log_probability,) = bound.log_probability(np.zeros((1, 1)))
        assert np.exp(log_probability) == pytest.approx(shown.mean(), abs=0.005)

    def test_what_is_known_stays_as_it_is(self):
        for limit, expected in ((1.1, 1.0), (0.9, 0.0)):
            bound = FutureBound(Known(limit, 1.0, 1.0, 0.0, 0.01), 4, 0.975)
            assert np.exp(bound.log_probability(np.zeros((1, 1)))) == pytest.approx([expected])

    def test_a_run_in_the_worst_context_tells_by_the_noise_there(self):
        process = fitted(*scattered(400, sd=lambda c: 0.01 if c < 0.5 else 0.05))
        z = float(norm.ppf(0.9))
        x = np.array([[0.5]])
        _, _, of_mean = EveryContext(process, 1.5, CORNERS).forecast(x)
        _, _, of_runs = EveryContext(process, 1.5, CORNERS, z).forecast(x)
        assert of_mean == pytest.approx([0.05**2], rel=0.5)
        assert of_runs / of_mean == pytest.approx([1.0 + z**2 / 2.0])


class TestLimitOnSingleRuns:
    """A limit on the mean as one that runs keep, with normal noise of a known deviation."""

    NOISE = 0.2

    @pytest.fixture(scope="class")
    @classmethod
    def process(cls):
        rng = np.random.default_rng(3)
        x, c = rng.random((400, 1)), rng.random((400, 1))
        y = x[:, 0] + c[:, 0] + cls.NOISE * rng.standard_normal(400)
        return fitted(x, c, y)

    def test_in_every_context(self, process):
        """In the worst context, c = 1, the 97.5 % quantile is x + 1 + 1.96 σ."""
        limit = EveryContext(process, 2.0, np.array([[0.0], [1.0]]))
        x = np.array([[0.3], [0.6]])
        quantile = limit.on_runs(0.975).predict_mean(x)
        expected = x[:, 0] + 1.0 + norm.ppf(0.975) * self.NOISE
        assert quantile == pytest.approx(expected, abs=0.1)
        assert limit.predict_mean(x) == pytest.approx(x[:, 0] + 1.0, abs=0.06)

    def test_a_run_deviates_by_its_noise_and_over_contexts_by_their_draw(self, process):
        """The response is x + c with c uniform from 0 to 1, which has the variance 1/12."""
        x, contexts = np.array([[0.4]]), np.linspace(0.0, 1.0, 101)[:, None]
        everywhere = EveryContext(process, 2.0, contexts).deviation_of_run(x)
        assert everywhere == pytest.approx(self.NOISE, rel=0.25)
        over = OverContexts(process, 2.0, contexts, 0.9).deviation_of_run(x)
        assert over == pytest.approx((self.NOISE**2 + 1.0 / 12.0) ** 0.5, rel=0.15)

    def test_never_asks_for_less_than_the_limit_does(self, process):
        limit = EveryContext(process, 2.0, CORNERS, deviations=3.0)
        assert limit.on_runs(0.9).deviations == 3.0
        over = OverContexts(process, 2.0, CORNERS, 0.99)
        assert (over.on_runs(0.9).probability, over.on_runs(0.999).probability) == (0.99, 0.999)
