"""Processes over parameter set and context, against scikit-learn and closed forms."""

import pickle
import weakref

import numpy as np
import pytest
from pooled_data import CORNERS, PLAIN, fitted, scattered
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF, ConstantKernel

from bo_tuner.models import conditioning, context_reduction
from bo_tuner.models.categories import Coding
from bo_tuner.models.pooled_process import PooledProcess


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


class TestKnownErrors:
    def test_posterior_is_that_of_an_independent_library(self):
        """With the error of each response as its noise; some points have two responses."""
        x, c, y = scattered(30)
        errors = np.random.default_rng(1).uniform(0.01, 0.3, len(y))
        start = fitted(x, c, y).warm_start
        process = PooledProcess.condition(start, x, c, y, coding=PLAIN, errors=errors)
        theta, scale = process.hyperparameters, process.scale
        kernel = ConstantKernel(theta.signal**2) * RBF(theta.length_scales) + ConstantKernel(1.0)
        regressor = GaussianProcessRegressor(kernel, alpha=(errors / scale) ** 2, optimizer=None)
        regressor.fit(np.hstack([x, c]), (y - y.mean()) / scale)
        at, which = np.array([[0.2], [0.7]]), np.array([1, 1])
        mean, deviation = regressor.predict(np.hstack([at, CORNERS[which]]), return_std=True)
        assert process.means(at, CORNERS)[:, 1] == pytest.approx(y.mean() + scale * mean, abs=1e-8)
        variances = process.variances(at, CORNERS, which)
        assert np.sqrt(variances) == pytest.approx(scale * deviation, rel=1e-4)

    def test_noise_elsewhere_is_that_of_the_others(self):
        """Half of the responses have a large error, which is known: others scatter by 0.01."""
        x, c, y = scattered(80)
        rng = np.random.default_rng(3)
        known = np.where(np.arange(80) % 2, 0.5, np.nan)
        y = y + np.nan_to_num(known) * rng.standard_normal(80)
        at, which = np.full((1, 1), 0.5), np.array([1])
        start = fitted(*scattered(80)).warm_start
        with_errors = PooledProcess.condition(start, x, c, y, coding=PLAIN, errors=known)
        without = PooledProcess.condition(start, x, c, y, coding=PLAIN)
        true = 0.5 + 0.25
        off = [abs(p.means(at, CORNERS)[0, 1] - true) for p in (with_errors, without)]
        assert off[0] < 0.02 < off[1]
        noise = [np.sqrt(p.noise(at, CORNERS, which)[0][0]) for p in (with_errors, without)]
        assert noise[0] < 0.1 < noise[1]


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
        shift, scale = process.standardization.shift, process.scale
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
        assert found == pytest.approx(process.standardization.restore(mean, sd)[0], abs=1e-8)
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
        again = PooledProcess.condition(process.warm_start, x, c, y, coding=PLAIN)
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
        assert np.abs(found - process.standardization.restore(mean, sd)[0]).max() < 2e-4
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
