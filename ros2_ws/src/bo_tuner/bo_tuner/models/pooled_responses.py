"""Objective and limits of a parameter set, by processes that include the context."""

from abc import abstractmethod
from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Protocol, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import ndtr, ndtri

from bo_tuner.models.compression import NO_COMPRESSION, Compression
from bo_tuner.models.constraints import LimitedResponse
from bo_tuner.models.context_process import ContextProcess
from bo_tuner.models.model_scale import ModelScale
from bo_tuner.models.protocol import Model
from bo_tuner.numerics.arrays import Array
from bo_tuner.study.parts import LOG, Objective

SMOOTHING = 0.05
"""Part of the spread over the contexts that is added to the noise in each of them."""

HALVINGS = 14
"""Bisections for a quantile: to 1e-4 of the spread of those of the contexts."""


class PooledObjective(Model, Protocol):
    """Posterior of the cost, by processes of all runs."""

    def weighted(self, weights: Array) -> Self:
        """Return the cost with other weights (k,) of several objectives."""

    def variance_of_run(self, x: ArrayLike) -> Array:
        """Return the variance (m,) of the cost of one run in a drawn context at x (m, d)."""


@dataclass(frozen=True, eq=False)
class ExpectedObjective:
    """Cost of the expectation of the objective's metric over the contexts; see `Model`.

    On the log scale the expectation is that of the metric itself, not of its logarithm: with
    f(x, c) the process of log C and σ² its noise, E[C] is the mean of exp(f + σ²/2) over the
    contexts. The variance is that of the mean of f over the contexts.

    Predictions are on the scale of `compression`, means alone in the cost's unit.

    Attributes
    ----------
    process
        Of the cost in a context.
    contexts : ndarray, shape (k, e)
        Drawn from their distribution, in the unit cube.
    objective
        The study's; says the scale.
    tried : tuple of ndarray, shapes (p, d) and (p,), or None
        The parameter sets that have runs, and how many, where the process knows others, too.
    compression
        Scale of the process, which a cost has in a single context only.
    """

    process: ContextProcess
    contexts: Array
    objective: Objective
    tried: tuple[Array, Array] | None = None
    compression: Compression = NO_COMPRESSION

    @property
    def points(self) -> Array:  # noqa: D102
        return self.process.points if self.tried is None else self.tried[0]

    @property
    def counts(self) -> Array:  # noqa: D102
        return self.process.counts if self.tried is None else self.tried[1]

    @property
    def length_scales(self) -> Array:  # noqa: D102
        return self.process.length_scales[: self.points.shape[1]]

    @property
    def scale(self) -> float:  # noqa: D102
        return self.process.scale

    @property
    def noise_variance(self) -> float:  # noqa: D102
        return self.process.noise_variance

    @property
    def warm_start(self) -> tuple[float, ...]:  # noqa: D102
        return self.process.warm_start

    @property
    def warnings(self) -> tuple[str, ...]:  # noqa: D102
        return self.process.warnings

    def predict(self, x: ArrayLike) -> tuple[Array, Array]:
        """Return mean and variance (m,) of the cost at x (m, d)."""
        points = np.asarray(x, dtype=np.float64)
        return self._mean(points), self.process.variance_of_mean(points, self.contexts)

    def predict_mean(self, x: ArrayLike) -> Array:
        """Return the mean (m,) alone at x (m, d), in the cost's unit."""
        return self.compression.restore(self._mean(x))

    def _mean(self, x: ArrayLike) -> Array:
        cost = self.process.means(np.asarray(x, dtype=np.float64), self.contexts)
        if self.objective.scale != LOG:
            linear: Array = cost.mean(axis=1)
            return linear
        logarithm = _log_mean_exp(self.objective.sign * cost)
        log_mean: Array = self.objective.sign * (logarithm + 0.5 * self.noise_variance)
        return log_mean

    def predict_reinterpolated(self, x: ArrayLike) -> tuple[Array, Array]:
        """Return as `predict`, with a variance of 0 at `points`."""
        points = np.asarray(x, dtype=np.float64)
        mean, variance = self.predict(points)
        return mean, np.where(self.evaluated(points), 0.0, variance)

    def evaluated(self, x: ArrayLike) -> NDArray[np.bool_]:
        """Return which (m,) of x (m, d) are among `points`."""
        points = np.ascontiguousarray(x, dtype=np.float64)
        return np.array([point.tobytes() in self._evaluated for point in points], dtype=bool)

    def variance_of_run(self, x: ArrayLike) -> Array:
        """Return the variance (m,) of the cost of one run in a drawn context at x (m, d)."""
        means = self.process.means(np.asarray(x, dtype=np.float64), self.contexts)
        variance: Array = means.var(axis=1) + self.noise_variance
        return variance

    def weighted(self, weights: Array) -> Self:
        """Return itself: a single objective has no weights."""
        return self

    @cached_property
    def _evaluated(self) -> set[bytes]:
        return {point.tobytes() for point in self.points}


class PooledResponse(LimitedResponse):
    """Limit on a response by the process of all runs, to which a further run can be added.

    The process is one of the metric on the scale of `scale`, which keeps the limit. Means
    and variances are on that scale; `predict_mean` and `band` are in the metric's unit.
    """

    scale: ModelScale

    @abstractmethod
    def on_runs(self, level: float) -> Self:
        """Return the limit that runs keep with the probability `level`, or more if it is so now."""

    @abstractmethod
    def forecast(self, x: Array) -> tuple[Array, Array, Array]:
        """Return mean and variance (m,) of the limited quantile at x (m, d), and that of a run.

        The last is the variance (m,) of the quantile estimated from one further run.

        A quantile is estimated by the mean of runs plus z times their standard deviation. From n
        runs with the variance σ², that has about the variance σ² (1 + z² / 2) / n.
        """

    def predict(self, x: Array) -> tuple[Array, Array]:
        """Return mean and variance (m,) of the limited quantile at x (m, d)."""
        mean, variance, _ = self.forecast(x)
        return mean, variance

    def predict_mean(self, x: Array) -> Array:
        """Return the mean (m,) of the limited quantile at x (m, d) in the metric's unit."""
        return self.scale.restore(self.predict(x)[0])

    def band(self, x: Array, deviations: float) -> tuple[Array, Array, Array]:
        """Return mean, lower and upper end (m,) of a band at x (m, d) in the metric's unit."""
        mean, low, high = map(self.scale.restore, super().band(x, deviations))
        return mean, low, high

    @abstractmethod
    def deviation_of_run(self, x: Array) -> Array:
        """Return the standard deviation (m,) of one run of x (m, d), on the scale of the process.

        It is that of its noise, and where the limit is one over contexts also of their draw.
        """

    def doubtful_context(self, x: Array) -> tuple[Array | None, float]:
        """Return where runs of x (1, d) show most clearly whether the limit is kept.

        Returns
        -------
        ndarray, shape (e,), or None
            A context in the unit cube; None for one that is drawn.
        float
            Log probability that the limit is kept there.
        """
        return None, float(self.log_probability(x)[0])

    def log_kept_in(self, x: Array, contexts: Array) -> Array | None:
        """Return the log probability (k,) that the limit is kept by x (1, d) in contexts (k, e).

        None if the limit is not one in every context.
        """
        return None


@dataclass(frozen=True, eq=False)
class EveryContext(PooledResponse):
    """Limit on a metric in every context, by its process over parameter set and context.

    A single run stays below mean + k σ, or above mean - k σ for a lower limit, with the
    constraint's probability Φ(z), where σ is the local noise and k its reach by the residuals of
    all runs (`noise_shape`), at least z; 0 if the limit is on the mean, which is that of the
    metric, not of its scale. The uncertainty is that of both: with ν degrees of freedom the
    variance of k σ is about k² σ² / (2 ν).

    Attributes
    ----------
    process
        Of the metric.
    limit
        In the metric's unit.
    contexts : ndarray, shape (k, e)
        Candidates for the worst one, in the unit cube.
    deviations
        z.
    sign
        1 for an upper limit, -1 for a lower one.
    scale
        That of the process.
    """

    process: ContextProcess
    limit: float
    contexts: Array
    deviations: float = 0.0
    sign: float = 1.0
    scale: ModelScale = NO_COMPRESSION

    @cached_property
    def _reach(self) -> float:
        """k, in local standard deviations of the noise; 0 for a limit on the mean."""
        if not self.deviations:
            return 0.0
        return self.process.noise_deviations(self.deviations, self.sign)

    def on_runs(self, level: float) -> Self:  # noqa: D102
        return replace(self, deviations=max(self.deviations, float(ndtri(level))))

    def worst_case(self, x: Array) -> tuple[NDArray[np.intp], Array, Array]:
        """Return row and mean of the worst context, and its noise's standard deviation, (m,) each.

        The mean is that of the metric, in its unit, also if the limit is one on single runs. It is
        no farther within the limit than any response: a metric that is never negative, such as an
        overshoot, has no negative worst case.
        """
        rows, mean = self._worst(x)
        least, largest = self.process.range
        mean = np.maximum(mean, least) if self.sign > 0.0 else np.minimum(mean, largest)
        noise = np.sqrt(self.process.noise(x, self.contexts, rows)[0])
        deviation = self.scale.restore_deviation(noise, mean)
        return rows, self.scale.expectation(mean, noise), deviation

    def estimate(self, x: Array) -> tuple[Array, float, float]:
        """Return the worst context (e,) of x (1, d), and the metric's mean and noise there."""
        rows, mean, noise = self.worst_case(x)
        return self.contexts[rows[0]], float(mean[0]), float(noise[0])

    def doubtful_context(self, x: Array) -> tuple[Array | None, float]:
        """Return the most doubtful context (e,) of x (1, d), and the log probability there."""
        rows, log_probability = self.most_doubtful(x)
        return self.contexts[rows[0]], float(log_probability[0])

    def deviation_of_run(self, x: Array) -> Array:
        """Return the standard deviation (m,) of the noise in the context where it is largest."""
        largest: Array = self.process.noise_everywhere(x, self.contexts)[0].max(axis=1)
        return np.sqrt(largest)

    def log_kept_in(self, x: Array, contexts: Array) -> Array:
        """Return the log probability (k,) that the limit is kept by x (1, d) in contexts (k, e)."""
        in_contexts = replace(self, contexts=contexts)
        points = np.tile(x, (len(contexts), 1))
        return self.log_kept(*in_contexts.predict_in(points, np.arange(len(contexts))))

    def forecast(self, x: Array) -> tuple[Array, Array, Array]:
        """Return as `PooledResponse.forecast`, of a run in the worst context."""
        rows, mean = self._worst(x)
        return self._quantile(x, rows, mean, *self.process.noise(x, self.contexts, rows))

    def predict_mean(self, x: Array) -> Array:
        """Return the mean (m,) of the limited quantile at x (m, d) in the metric's unit."""
        rows, mean = self._worst(x)
        noise, _ = self.process.noise(x, self.contexts, rows)
        return self.scale.restore(self._limited(mean, np.sqrt(noise)))

    def predict_in(self, x: Array, which: NDArray[np.intp]) -> tuple[Array, Array]:
        """Return mean and variance (m,) of the quantile at x (m, d), in a context each."""
        mean = self.process.means(x, self.contexts)[np.arange(len(x)), which]
        noise = self.process.noise(x, self.contexts, which)
        quantile, variance, _ = self._quantile(x, which, mean, *noise)
        return quantile, variance

    def limited(self, x: Array) -> Array:
        """Return what is limited at x (m, d) in each context, on the scale of the process, (m, k).

        A quantile of runs, or their mean.
        """
        return self._in_each(x)[1]

    def _in_each(self, x: Array) -> tuple[Array, Array]:
        """Return the mean and what is limited at x (m, d) in each context, (m, k) each."""
        means = self.process.means(x, self.contexts)
        noise, _ = self.process.noise_everywhere(x, self.contexts)
        return means, self._limited(means, np.sqrt(noise))

    def _worst(self, x: Array) -> tuple[NDArray[np.intp], Array]:
        """Return row and mean (m,) of the worst context: where what is limited is worst."""
        means, limited = self._in_each(x)
        rows = (self.sign * limited).argmax(axis=1)
        return rows, means[np.arange(len(x)), rows]

    def _quantile(
        self, x: Array, which: NDArray[np.intp], mean: Array, noise: Array, degrees: Array
    ) -> tuple[Array, Array, Array]:
        """Return a `forecast` in a context each, where the metric's mean and noise are known."""
        variance = self.process.variances(x, self.contexts, which)
        margin = self._reach * np.sqrt(noise)
        return (
            self._limited(mean, np.sqrt(noise)),
            variance + margin**2 / (2.0 * degrees),
            _variance_of_quantile(noise, self._reach),
        )

    def _limited(self, mean: Array, noise: Array) -> Array:
        """Return what is limited, by mean and noise of runs; all of one shape."""
        if self.deviations:
            return mean + self.sign * self._reach * noise
        return self.scale.apply(self.scale.expectation(mean, noise))

    def least_log_probability(self, x: Array) -> Array:
        """Return the log probability (m,) that the limit holds in the most doubtful context."""
        return self.most_doubtful(x)[1]

    def most_doubtful(self, x: Array) -> tuple[NDArray[np.intp], Array]:
        """Return the row of the most doubtful context, and the log probability there, (m,) each."""
        least, rows = np.full(len(x), np.inf), np.zeros(len(x), dtype=np.intp)
        means = self.process.means(x, self.contexts)
        noise, degrees = self.process.noise_everywhere(x, self.contexts)
        for row, (mean, *of_runs) in enumerate(zip(means.T, noise.T, degrees.T, strict=True)):
            quantile, variance, _ = self._quantile(x, np.full(len(x), row), mean, *of_runs)
            log_probability = self.log_kept(quantile, variance)
            rows[log_probability < least] = row
            least = np.minimum(least, log_probability)
        return rows, least


@dataclass(frozen=True, eq=False)
class OverContexts(PooledResponse):
    """Limit that a run keeps with a probability over contexts and noise, by the pooled process.

    The quantile q of runs solves mean_c Φ((q - f_c) / σ_c) = `probability`, with the process f_c
    and the local noise σ_c in the context c; it must keep the limit. To first order its error is
    that of the sum of w_c f_c, where w_c ∝ φ((q - f_c) / σ_c) / σ_c add up to 1 (implicit
    differentiation).

    Attributes
    ----------
    process
        Of the metric.
    limit
        In the metric's unit.
    contexts : ndarray, shape (k, e)
        Drawn from their distribution, in the unit cube.
    probability
        Of a run within the limit.
    sign
        1 for an upper limit, -1 for a lower one.
    scale
        That of the process.
    """

    process: ContextProcess
    limit: float
    contexts: Array
    probability: float
    sign: float = 1.0
    scale: ModelScale = NO_COMPRESSION

    def on_runs(self, level: float) -> Self:  # noqa: D102
        return replace(self, probability=max(self.probability, level))

    def forecast(self, x: Array) -> tuple[Array, Array, Array]:
        """Return as `PooledResponse.forecast`, of a run in a drawn context."""
        mean, noise, degrees, deviation = self._everywhere(x)
        quantile, z = self._quantile(mean, deviation), float(ndtri(self.probability))
        standardized = (quantile[:, None] - mean) / deviation
        # Relative to the largest, so that they do not vanish all at once.
        logarithm = -0.5 * standardized**2 - np.log(deviation)
        weights = np.exp(logarithm - logarithm.max(axis=1, keepdims=True))
        weights /= weights.sum(axis=1, keepdims=True)
        variance = self.process.variance_of_weighted(x, self.contexts, weights)
        margin = (weights * standardized * np.sqrt(noise / (2.0 * degrees))).sum(axis=1)
        of_runs = mean.var(axis=1) + noise.mean(axis=1)
        return self.sign * quantile, variance + margin**2, _variance_of_quantile(of_runs, z)

    def deviation_of_run(self, x: Array) -> Array:
        """Return the standard deviation (m,) of a run in a drawn context."""
        mean, noise, _, _ = self._everywhere(x)
        deviation: Array = np.sqrt(mean.var(axis=1) + noise.mean(axis=1))
        return deviation

    def predict_mean(self, x: Array) -> Array:
        """Return the limited quantile (m,) at x (m, d) in the metric's unit."""
        mean, _, _, deviation = self._everywhere(x)
        return self.scale.restore(self.sign * self._quantile(mean, deviation))

    def _everywhere(self, x: Array) -> tuple[Array, Array, Array, Array]:
        """Return mean, noise variance, its degrees of freedom and the deviation in all contexts.

        The mean has the sign of an upper limit. All have the shape (m, k).
        """
        mean = self.sign * self.process.means(x, self.contexts)
        noise, degrees = self.process.noise_everywhere(x, self.contexts)
        z = float(ndtri(self.probability))
        # Noise with a longer tail than a normal one counts as a normal one that reaches as far.
        longer = self.process.noise_deviations(z, self.sign) / z if z > 0.0 else 1.0
        # A few contexts stand for all: without noise, each also for those next to it.
        deviation = longer * np.sqrt(noise) + SMOOTHING * mean.std(axis=1, keepdims=True)
        return mean, noise, degrees, deviation + np.finfo(np.float64).tiny

    def _quantile(self, mean: Array, deviation: Array) -> Array:
        """Return the quantile (m,) of normal runs in all contexts, each argument (m, k)."""
        z = ndtri(self.probability)
        lower, upper = (mean + z * deviation).min(axis=1), (mean + z * deviation).max(axis=1)
        for _ in range(HALVINGS):
            middle = 0.5 * (lower + upper)
            kept = ndtr((middle[:, None] - mean) / deviation).mean(axis=1)
            lower = np.where(kept < self.probability, middle, lower)
            upper = np.where(kept < self.probability, upper, middle)
        quantile: Array = upper
        return quantile


@dataclass(frozen=True, eq=False)
class FutureBound(LimitedResponse):
    """Limit on the confidence bound of a response after further runs of the same parameter set.

    With s² the variance of the response today and t² that of its estimate from a run, n runs leave
    the variance s_n² = s² t² / (t² + n s²). The bound is then the mean plus z s_n, or minus for a
    lower limit, and seen from today its mean has the variance s² - s_n². So the probability that it
    keeps the limit is that with which the response is *shown* to keep it after n runs.

    Attributes
    ----------
    response
        The constrained response.
    runs
        n.
    confidence
        One-sided, of the bound: Φ(z).
    """

    response: PooledResponse
    runs: int
    confidence: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "limit", self.response.limit)
        object.__setattr__(self, "sign", self.response.sign)

    def predict(self, x: Array) -> tuple[Array, Array]:
        """Return mean and variance (m,) of the bound at x (m, d)."""
        return bound_after(self.response, self.response.forecast(x), self.runs, self.confidence)


def bound_after(
    response: PooledResponse, forecast: Iterable[Array], runs: int, confidence: float
) -> tuple[Array, Array]:
    """Return mean and variance (m,) of a `FutureBound` by a `forecast` of the response."""
    mean, variance, run = forecast
    left = variance * run / np.maximum(run + runs * variance, np.finfo(np.float64).tiny)
    return mean + response.sign * float(ndtri(confidence)) * np.sqrt(left), variance - left


def _variance_of_quantile(variance: Array, deviations: float) -> Array:
    """Return the variance of mean + z σ estimated from one run of the `variance` σ²."""
    return variance * (1.0 + 0.5 * deviations**2)


def _log_mean_exp(values: Array) -> Array:
    """Return log of the mean of exp(values) over the columns, (m,) of (m, k)."""
    largest: Array = values.max(axis=1)
    log_mean: Array = largest + np.log(np.exp(values - largest[:, None]).mean(axis=1))
    return log_mean
