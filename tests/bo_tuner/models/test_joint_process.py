"""Processes over parameter set and context, against scikit-learn and closed forms."""

import pickle
import weakref

import numpy as np
import pytest
from scipy.stats import norm
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF, ConstantKernel

from bo_tuner.models import conditioning, context_reduction
from bo_tuner.models.categories import Coding
from bo_tuner.models.crashes import CrashModel
from bo_tuner.models.joint_process import JointProcess
from bo_tuner.models.joint_responses import (
    EveryContext,
    ExpectedObjective,
    FutureBound,
    OverContexts,
    PooledResponse,
)
from bo_tuner.models.nearest_neighbours import NeighbourClassifier
from bo_tuner.study.context_space import ContextSpace
from bo_tuner.study.distributions import Uniform
from bo_tuner.study.parts import Objective

PLAIN = Coding((0,))
CORNERS = np.array([[0.0], [0.5], [1.0]])


def scattered(count, seed=0, sd=lambda c: 0.01):
    """Values of x + c² with noise, at random points and, every third, at ones seen before."""
    rng = np.random.default_rng(seed)
    x, c = rng.random((count, 1)), rng.random((count, 1))
    again = np.arange(2, count, 3)
    x[again], c[again] = x[again - 1], c[again - 1]
    y = x[:, 0] + c[:, 0] ** 2 + np.vectorize(sd)(c[:, 0]) * rng.standard_normal(count)
    return x, c, y


def fitted(x, c, y, coding=PLAIN):
    return JointProcess.fit(x, c, y, coding=coding, rng=np.random.default_rng(0))


def reference(process):
    """The same posterior by scikit-learn, given kernel and noise, in the unit of the response."""
    theta = process.hyperparameters
    kernel = ConstantKernel(theta.signal**2) * RBF(theta.length_scales) + ConstantKernel(1.0)
    x, c = process.data.x[:, : process.columns], process.data.x[:, process.columns :]
    noise, _ = process.noise(process.coding.decode(x), c, np.arange(len(c)))
    regressor = GaussianProcessRegressor(
        kernel, alpha=noise / process.scale**2 / process.data.count, optimizer=None
    )
    return regressor.fit(process.data.x, process.data.mean)


class TestPosterior:
    @pytest.fixture
    def process(self):
        return fitted(*scattered(60))

    def test_is_that_of_the_points_also_if_they_have_changed_in_place(self, process):
        """The kernels of the latest points and contexts are known, by their content."""
        x, contexts, first = np.array([[0.1], [0.45]]), CORNERS.copy(), np.zeros(2, dtype=np.intp)
        process.means(x, contexts)
        x[:], contexts[:] = [[0.9], [0.2]], CORNERS[::-1]
        process.variance_of_mean(x, contexts)
        contexts[0] = 0.3
        fresh = fitted(*scattered(60))
        np.testing.assert_array_equal(process.means(x, contexts), fresh.means(x, contexts))
        np.testing.assert_array_equal(
            process.variances(x, contexts, first), fresh.variances(x, contexts, first)
        )
        np.testing.assert_array_equal(
            process.variance_of_mean(x, contexts), fresh.variance_of_mean(x, contexts)
        )

    def test_is_that_of_an_independent_library(self, process):
        x = np.array([[0.1], [0.45], [0.9]])
        which = np.array([2, 0, 1])
        mean, deviation = reference(process).predict(
            np.hstack([x, CORNERS[which]]), return_std=True
        )
        shift, scale = process.standardisation.shift, process.scale
        means = process.means(x, CORNERS)[np.arange(3), which]
        assert means == pytest.approx(shift + scale * mean, abs=1e-8)
        variances = process.variances(x, CORNERS, which)
        assert np.sqrt(variances) == pytest.approx(scale * deviation, rel=1e-4)

    @pytest.mark.parametrize("basis", [conditioning.BASIS, 60])
    def test_of_many_parameter_sets_in_a_context(self, monkeypatch, basis):
        """By a factor of its own, where each parameter set has several evaluations."""
        monkeypatch.setattr(conditioning, "BASIS", basis)
        process = self.repeated(sd=0.05)
        query = np.random.default_rng(4).random((context_reduction.WORTH_A_FACTOR + 1, 1))
        first = np.zeros(len(query), dtype=np.intp)
        found = process.variances(query, CORNERS, first)
        mean = process.variance_of_mean(query, CORNERS)
        assert sorted(process._reduction(CORNERS)._factors) == [0, 3]
        # One context has a factor now, and another one has none yet.
        some, which = query[:10], np.arange(10) % 2
        directly = process.variances(some, CORNERS[which], np.arange(10))
        assert process.variances(some, CORNERS, which) == pytest.approx(directly, rel=1e-6)
        assert found[:10:2] == pytest.approx(directly[::2], rel=1e-6)
        others = CORNERS[::-1].copy()
        assert mean[:10] == pytest.approx(process.variance_of_mean(some, others), rel=1e-6)

    def test_without_noise_has_no_factor(self):
        """It would have too few digits for variances as small as these."""
        process = self.repeated(sd=0.0)
        query = np.random.default_rng(4).random((context_reduction.WORTH_A_FACTOR + 1, 1))
        process.variance_of_mean(query, CORNERS)
        assert not process._reduction(CORNERS)._factors

    def repeated(self, sd):
        """A process with ten evaluations of each of twelve parameter sets."""
        rng = np.random.default_rng(3)
        x, c = np.repeat(rng.random((12, 1)), 10, axis=0), rng.random((120, 1))
        return fitted(x, c, np.sin(9.0 * x[:, 0]) + c[:, 0] ** 2 + sd * rng.standard_normal(120))

    def test_is_freed_with_its_last_user(self, process):
        """Large models must not wait for the garbage collector."""
        process.means(np.array([[0.5]]), CORNERS)
        process.variance_of_mean(np.array([[0.5]]), CORNERS)
        process.noise(np.array([[0.5]]), CORNERS, np.zeros(1, dtype=np.intp))
        copy = pickle.loads(pickle.dumps(process))
        gone = weakref.ref(copy)
        del copy
        assert gone() is None

    def test_of_choices_is_that_of_an_independent_library(self):
        rng = np.random.default_rng(5)
        x, c = rng.integers(0, 3, (60, 1)) / 2.0, rng.random((60, 1))
        coding = Coding((3,))
        process = fitted(x, c, x[:, 0] * c[:, 0] + 0.1 * rng.standard_normal(60), coding)
        query, which = np.array([[0.0], [0.5], [1.0]]), np.array([2, 0, 1])
        mean, sd = reference(process).predict(
            np.hstack([coding.encode(query), CORNERS[which]]), return_std=True
        )
        found = process.means(query, CORNERS)[np.arange(3), which]
        assert found == pytest.approx(process.standardisation.restore(mean, sd)[0], abs=1e-8)
        variance = process.variances(query, CORNERS, which)
        assert np.sqrt(variance) == pytest.approx(process.scale * sd, rel=1e-4)
        whole = process.noise_everywhere(query, CORNERS)
        for one, every in zip(process.noise(query, CORNERS, which), whole, strict=True):
            assert one == pytest.approx(every[np.arange(3), which])

    def test_without_contexts_is_that_of_an_independent_library(self):
        rng = np.random.default_rng(6)
        x, nothing = rng.random((40, 1)), np.empty((40, 0))
        process = fitted(x, nothing, np.sin(5.0 * x[:, 0]) + 0.1 * rng.standard_normal(40))
        query, context = np.array([[0.2], [0.9]]), np.empty((1, 0))
        kernel = ConstantKernel(process.hyperparameters.signal**2) * RBF(
            process.hyperparameters.length_scales
        ) + ConstantKernel(1.0)
        own = process.noise(process.data.x, context, np.zeros(len(process.data.x), dtype=np.intp))
        regressor = GaussianProcessRegressor(
            kernel, alpha=own[0] / process.scale**2 / process.data.count, optimizer=None
        ).fit(process.data.x, process.data.mean)
        _, sd = regressor.predict(query, return_std=True)
        variance = process.variances(query, context, np.zeros(2, dtype=np.intp))
        assert np.sqrt(variance) == pytest.approx(process.scale * sd, rel=1e-4)
        assert process.variance_of_mean(query, context) == pytest.approx(variance, rel=1e-6)

    def test_of_the_mean_over_contexts(self, process):
        """Its variance is the mean of all covariances of the contexts."""
        z = np.hstack([np.full((3, 1), 0.45), CORNERS])
        _, covariance = reference(process).predict(z, return_cov=True)
        found = process.variance_of_mean(np.array([[0.45]]), CORNERS)
        assert found == pytest.approx(process.scale**2 * covariance.mean(), rel=1e-4)

    def test_conditioned_on_more_data(self):
        x, c, y = scattered(60)
        process = fitted(x, c, y)
        again = JointProcess.condition(process.warm_start, x, c, y, coding=PLAIN)
        assert again.means(x, CORNERS) == pytest.approx(process.means(x, CORNERS))

    def test_without_contexts(self):
        x, _, _ = scattered(40)
        nothing = np.empty((40, 0))
        process = fitted(x, nothing, 2.0 * x[:, 0])
        at = np.array([[0.3], [0.7]])
        assert process.means(at, np.empty((1, 0)))[:, 0] == pytest.approx([0.6, 1.4], abs=0.01)

    def test_of_choices(self):
        """Three choices without an order, each with its own level."""
        rng = np.random.default_rng(0)
        x = rng.integers(0, 3, (60, 1)) / 2.0
        level = np.array([1.0, -2.0, 0.5])[np.rint(2.0 * x[:, 0]).astype(int)]
        process = fitted(x, rng.random((60, 1)), level, Coding((3,)))
        found = process.means(np.array([[0.0], [0.5], [1.0]]), CORNERS)[:, 1]
        assert found == pytest.approx([1.0, -2.0, 0.5], abs=0.05)
        assert sorted(process.points[:, 0]) == [0.0, 0.5, 1.0]
        assert process.counts.sum() == 60

    def test_of_very_many_runs_is_that_of_an_independent_library(self, monkeypatch):
        """On a basis; the library conditions on all of them."""
        monkeypatch.setattr(conditioning, "BASIS", 400)
        process = fitted(*scattered(1500))
        assert len(process.posterior.basis) < len(process.data.x) == 1000
        x = np.array([[0.1], [0.45], [0.9]])
        mean, sd = reference(process).predict(
            np.hstack([np.repeat(x, 3, axis=0), np.tile(CORNERS, (3, 1))]), return_std=True
        )
        found = process.means(x, CORNERS).ravel()
        assert np.abs(found - process.standardisation.restore(mean, sd)[0]).max() < 2e-4
        variance = process.variances(np.repeat(x, 3, axis=0), CORNERS, np.tile([0, 1, 2], 3))
        assert np.sqrt(variance) == pytest.approx(process.scale * sd, rel=0.05)

    def test_a_rare_failure_among_very_many_runs_is_learnt(self):
        """The hyperparameters are fitted to some of the runs, with the failed ones among them."""
        rng = np.random.default_rng(0)
        x, c = rng.random((1200, 1)), rng.random((1200, 1))
        failed = (x[:, 0] > 0.95) & (c[:, 0] > 0.5)
        process = fitted(x, c, np.where(failed, 1.0, -1.0))
        found = process.means(np.array([[0.99], [0.5]]), np.array([[0.9]]))[:, 0]
        assert found[0] > 0.0 > -0.9 > found[1]


class TestLocalNoise:
    @pytest.mark.parametrize("seed", range(3))
    def test_follows_the_context(self, seed):
        """Noise of 0.01 on one side and of 0.05 on the other; the common one is 0.036."""
        x, c, y = scattered(300, seed, sd=lambda c: 0.01 if c < 0.5 else 0.05)
        process = fitted(x, c, y)
        variance, degrees = process.noise(np.full((2, 1), 0.5), CORNERS, np.array([0, 2]))
        ratio = np.sqrt(variance) / [0.01, 0.05]
        assert (np.abs(np.log(ratio)) < np.log(1.7)).all()
        assert (degrees > 30).all()

    def test_is_the_common_one_where_nothing_was_tried(self):
        x, c, y = scattered(100)
        process = fitted(0.1 * x, 0.1 * c, y)
        far = process.noise(np.array([[1.0]]), CORNERS, np.array([2]))
        assert far[0] == pytest.approx([process.noise_variance], rel=0.1)
        assert far[1] == pytest.approx([2.0], abs=0.5)

    def test_of_repetitions_of_one_point(self):
        """In number, they determine it: the sample's own standard deviation."""
        values = np.random.default_rng(1).normal(2.0, 0.3, 400)
        process = fitted(np.full((400, 1), 0.5), np.full((400, 1), 1.0), values)
        variance, _ = process.noise(np.array([[0.5]]), CORNERS, np.array([2]))
        assert np.sqrt(variance) == pytest.approx([values.std(ddof=1)], rel=0.02)


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


class TestCrashModel:
    def fit(self, crashed):
        x, c, _ = scattered(60)
        labels = crashed(x[:, 0], c[:, 0])
        neighbours = NeighbourClassifier(x, labels, np.array([0.25]))
        return CrashModel.fit(
            x, c, labels, coding=PLAIN, contexts=CORNERS, neighbours=neighbours,
            rng=np.random.default_rng(0),
        )  # fmt: skip

    def test_learns_where_runs_fail(self):
        model = self.fit(lambda x, c: x > 0.6)
        probability = model.probability(np.array([[0.1], [0.4], [0.75], [0.95]]))
        assert (probability[:2] < 0.15).all()
        assert (probability[2:] > 0.85).all()

    def test_one_context_is_enough(self):
        """Only under the largest loads does a run fail; at 0.1 never."""
        model = self.fit(lambda x, c: x * c > 0.4)
        low, high = model.probability(np.array([[0.1], [0.9]]))
        assert low < 0.15
        assert high > 0.85

    def test_close_to_a_failed_set_its_neighbours_decide(self):
        model = self.fit(lambda x, c: x > 0.6)
        failed = model.neighbours.x[model.labels]
        assert (model.probability(failed) == 1.0).all()

    def test_no_failure_no_doubt(self):
        model = self.fit(lambda x, c: np.zeros(len(x), dtype=bool))
        assert (model.probability(np.array([[0.1], [0.9]])) == 0.0).all()


class TestChance:
    """Quantile of runs over contexts and noise, against a closed form and sampling."""

    def process(self, rng, noise=0.1, slope=1.0):
        x, c = rng.random((150, 1)), rng.random((150, 1))
        y = x[:, 0] + slope * c[:, 0] + rng.normal(0.0, noise, 150)
        return JointProcess.fit(x, c, y, coding=PLAIN, rng=rng)

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

    def predict(self, x):
        return self.forecast(x)[:2]

    def forecast(self, x):
        return tuple(np.full(len(x), v) for v in (self._mean, self._variance, self._run))


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
