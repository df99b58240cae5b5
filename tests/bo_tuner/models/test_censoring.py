"""Censored observations, against closed forms and against data that is known whole."""

import numpy as np
import pytest
from pooled_data import PLAIN
from scipy.stats import norm

from bo_tuner.models.censoring import Censored, normal_factors
from bo_tuner.models.pooled_process import PooledProcess
from bo_tuner.models.replicates import Standardization

NOWHERE = np.empty((0, 1))


def censored(x, bounds):
    x = np.asarray(x, dtype=float).reshape(-1, 1)
    return Censored(x, np.empty((len(x), 0)), np.asarray(bounds, dtype=float))


class TestNormalFactors:
    @pytest.mark.parametrize(
        ("mean", "bound", "noise"),
        [(0.0, 1.0, 0.01), (0.0, 3.0, 0.01), (0.5, -2.0, 0.1), (0.0, 1.0, 1e-8), (0.0, 6.0, 1e-6)],
    )
    def test_a_single_one_has_the_moments_of_its_own_factor(self, mean, bound, noise):
        """Those of f ~ N(m, 1) given y = f + ε >= b are the closed form of a truncated normal."""

        def marginals(means, variances):
            variance = 1.0 / (1.0 + 1.0 / variances)
            return variance * (mean + means / variances), variance

        means, variances = normal_factors(marginals, np.array([bound]), np.array([noise]))
        found_mean, found_variance = marginals(means, variances)
        z = (mean - bound) / np.sqrt(1.0 + noise)
        ratio = norm.pdf(z) / norm.cdf(z)
        assert found_mean == pytest.approx(mean + ratio / np.sqrt(1.0 + noise), abs=1e-3)
        expected = 1.0 - ratio * (z + ratio) / (1.0 + noise)
        assert found_variance == pytest.approx(expected, abs=1e-3)

    def test_one_far_beyond_its_bound_tells_nothing(self):
        def marginals(means, variances):
            variance = 1.0 / (1.0 + 1.0 / variances)
            return variance * (means / variances), variance

        found = marginals(*normal_factors(marginals, np.array([-20.0]), np.array([0.01])))
        assert found[0] == pytest.approx(0.0, abs=0.01)
        assert found[1] == pytest.approx(1.0, abs=0.01)

    def test_none_tells_as_much_as_a_whole_one(self):
        """However precisely f is known to be near its bound."""

        def marginals(means, variances):
            variance = 1.0 / (1e4 + 1.0 / variances)
            return variance * (means / variances), variance

        _, variances = normal_factors(marginals, np.zeros(1), np.full(1, 0.01))
        assert variances[0] > 0.01


class TestProcess:
    """Of a known function at few places, some of which are censored."""

    X = np.linspace(0.0, 1.0, 13)[:, None]
    Y = np.sin(5.0 * X[:, 0])

    def process(self, of=None, at=NOWHERE, y=None):
        x = self.X if of is None else self.X[of]
        y = self.Y[of] if y is None else y
        return PooledProcess.fit(
            x, np.empty((len(x), 0)), y, coding=PLAIN, rng=np.random.default_rng(0), censored=at
        )

    def mean(self, process, x):
        x = np.atleast_2d(np.asarray(x, dtype=float)).reshape(-1, 1)
        return process.means(x, np.empty((1, 0)))[:, 0]

    def deviation(self, process, x):
        x = np.atleast_2d(np.asarray(x, dtype=float)).reshape(-1, 1)
        which = np.zeros(len(x), dtype=np.intp)
        return np.sqrt(process.variances(x, np.empty((1, 0)), which))

    def test_without_any_nothing_changes(self):
        plain, none = self.process(slice(None), None), self.process(slice(None), censored([], []))
        x = np.linspace(0.0, 1.0, 7)
        np.testing.assert_array_equal(self.mean(plain, x), self.mean(none, x))
        np.testing.assert_array_equal(plain.posterior.residuals, none.posterior.residuals)

    def test_one_has_the_closed_form_of_a_truncated_normal(self):
        """Without it f has mean and variance there; what it adds elsewhere is in proportion."""
        known = self.X[:, 0] < 0.55
        plain = self.process(known, None)
        at, elsewhere, bound = 0.8, 0.95, 0.5
        bounded = self.process(known, censored([at], [bound]))
        mean, deviation = self.mean(plain, at), self.deviation(plain, at)
        noise = plain.noise(np.array([[at]]), np.empty((1, 0)), np.zeros(1, dtype=np.intp))[0]
        total = np.sqrt(deviation**2 + noise)
        z = (mean - bound) / total
        ratio = norm.pdf(z) / norm.cdf(z)
        gained = deviation**2 / total * ratio
        assert self.mean(bounded, at) == pytest.approx(mean + gained, abs=2e-3 * plain.scale)
        assert self.deviation(bounded, at) ** 2 == pytest.approx(
            deviation**2 - deviation**4 / total**2 * ratio * (z + ratio), rel=5e-3
        )
        # Covariances of the process that was conditioned on the others, by one exact observation.
        exact = np.append(self.Y[known], mean + 1.0)
        through = PooledProcess.condition(
            plain.warm_start,
            np.vstack([self.X[known], [[at]]]),
            np.empty((known.sum() + 1, 0)),
            exact,
            coding=PLAIN,
        )
        slope = (self.mean(through, elsewhere) - self.mean(plain, elsewhere)) / (
            self.mean(through, at) - mean
        )
        added = self.mean(bounded, elsewhere) - self.mean(plain, elsewhere)
        assert added == pytest.approx(slope * gained, rel=0.15)

    def test_it_raises_the_mean_to_the_bound_and_no_further_than_it_must(self):
        """A bound that is far below what is expected changes nothing."""
        known = self.X[:, 0] < 0.85
        plain = self.process(known, None)
        loose = self.process(known, censored([0.9], [-4.0]))
        tight = self.process(known, censored([0.9], [1.0]))
        assert self.mean(loose, 0.9) == pytest.approx(self.mean(plain, 0.9), abs=1e-2)
        assert self.mean(tight, 0.9) > self.mean(plain, 0.9) + 0.1

    def test_noise_and_data_are_those_of_whole_runs(self):
        known = self.X[:, 0] < 0.55
        plain = self.process(known, None)
        bounded = self.process(known, censored([0.7, 0.8, 0.9], [2.0, 2.0, 2.0]))
        assert bounded.noise_variance == plain.noise_variance
        np.testing.assert_array_equal(bounded.points, plain.points)
        assert bounded.noise_deviations(1.0, 1.0) > 0.0

    def test_two_of_one_place_say_more_than_one(self):
        known = self.X[:, 0] < 0.55
        one = self.process(known, censored([0.9], [0.5]))
        two = self.process(known, censored([0.9, 0.9], [0.5, 0.5]))
        assert self.mean(two, 0.9) > self.mean(one, 0.9)
        assert np.isfinite(self.mean(two, 0.9)).all()


LENGTH, NOISE = 0.25, 0.1


def drawn(x, rng):
    """A function of the squared exponential kernel at x (n, 1), and its noisy values."""
    covariance = np.exp(-0.5 * ((x - x.T) / LENGTH) ** 2) + 1e-10 * np.eye(len(x))
    f = np.linalg.cholesky(covariance) @ rng.standard_normal(len(x))
    return f, f + NOISE * rng.standard_normal(len(x))


def of_truth(x, y, at):
    """The process with the hyperparameters of the functions."""
    scale = Standardization.of(y).scale
    theta = np.log([LENGTH, 1.0 / scale, NOISE / scale])
    none = np.empty((len(x), 0))
    return PooledProcess.condition(theta, x, none, y, coding=PLAIN, censored=at)


def of_fit(x, y, at):
    """The process with hyperparameters that are fitted to whole runs, as in a study."""
    none, rng = np.empty((len(x), 0)), np.random.default_rng(0)
    return PooledProcess.fit(x, none, y, coding=PLAIN, rng=rng, censored=at)


def biases(model, functions, seed):
    """Mean error at censored places by what is taken for their values; see the tests."""
    rng = np.random.default_rng(seed)
    errors = {"censored": [], "bounds": [], "without": []}
    for _ in range(functions):
        x = rng.random((24, 1))
        f, y = drawn(x, rng)
        bound = np.quantile(y, 0.6)
        cut = y > bound
        at = censored(x[cut, 0], np.full(cut.sum(), bound))
        models = {
            "censored": model(x[~cut], y[~cut], at),
            "bounds": model(x, np.minimum(y, bound), None),
            "without": model(x[~cut], y[~cut], None),
        }
        for name, process in models.items():
            errors[name].extend((process.means(x[cut], np.empty((1, 0)))[:, 0] - f[cut]).tolist())
    return {name: float(np.mean(values)) for name, values in errors.items()}


class TestBias:
    """Of functions drawn from the prior, whose runs are cut short above a bound: 40 % of them.

    In standard deviations of the functions. With bounds taken for values, or without these runs,
    the mean is too low there.
    """

    @pytest.mark.parametrize("seed", [1, 2])
    def test_there_is_next_to_none_by_a_process_that_is_right(self, seed):
        bias = biases(of_truth, 60, seed)
        assert bias["bounds"] < -0.3
        assert bias["without"] < -0.3
        assert abs(bias["censored"]) < 0.1

    def test_with_hyperparameters_of_whole_runs_half_of_it_goes(self):
        """They are fitted to values below the bound, and so to functions that move less."""
        bias = biases(of_fit, 25, 1)
        assert bias["bounds"] < -0.3
        assert bias["without"] < -0.3
        assert abs(bias["censored"]) < 0.5 * min(-bias["bounds"], -bias["without"])
