"""Cost of several objectives: the scalarization of their expectations, each by its own process.

The weights enter after the fits: other weights need no other fit. As in ParEGO with a model for
each objective (Daulton and others 2020, qParEGO), the scalarization is one of the posteriors. Its
mean is that of the posterior means, as the cost is one of means; its variance is, to first order,
that of the gradient times the costs, whose posteriors are independent.

References
----------
Daulton, Balandat and Bakshy (2020). Differentiable expected hypervolume improvement for parallel
multi-objective Bayesian optimization. NeurIPS 33.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import numpy as np
from numpy.typing import ArrayLike

from bo_tuner.models.compression import NO_COMPRESSION, Compression
from bo_tuner.models.pooled_responses import ExpectedObjective
from bo_tuner.models.scalarization import Chebyshev
from bo_tuner.numerics.arrays import Array


@dataclass(frozen=True, eq=False)
class ScalarizedObjective:
    """Scalarization of k costs at each point; see `Model`. It has no unit.

    Attributes
    ----------
    costs
        Models of the k costs, of the same evaluations.
    chebyshev
        The scalarization.
    """

    costs: Sequence[ExpectedObjective]
    chebyshev: Chebyshev

    def weighted(self, weights: Array) -> Self:
        """Return the cost with other weights (k,)."""
        return replace(self, chebyshev=replace(self.chebyshev, weights=weights))

    @property
    def points(self) -> Array:  # noqa: D102
        return self.costs[0].points

    @property
    def counts(self) -> Array:  # noqa: D102
        return self.costs[0].counts

    @property
    def length_scales(self) -> Array:  # noqa: D102
        least: Array = np.min([cost.length_scales for cost in self.costs], axis=0)
        return least

    @cached_property
    def scale(self) -> float:  # noqa: D102
        return float(self.predict_mean(self.points).std()) or 1.0

    @cached_property
    def noise_variance(self) -> float:  # noqa: D102
        noise = np.array([cost.noise_variance for cost in self.costs])
        return float((self.chebyshev.gradient(self._means(self.points)) ** 2 @ noise).mean())

    @property
    def warm_start(self) -> tuple[float, ...]:
        """Nothing: each of `costs` has its own."""
        return ()

    @property
    def warnings(self) -> tuple[str, ...]:
        """None beside those of `costs`."""
        return ()

    @property
    def compression(self) -> Compression:
        """None: the cost of a compromise has no unit."""
        return NO_COMPRESSION

    def predict(self, x: ArrayLike) -> tuple[Array, Array]:
        """Return mean and variance (m,) of the cost at x (m, d)."""
        means, variances = zip(*(cost.predict(x) for cost in self.costs), strict=True)
        each = np.column_stack(means)
        return self.chebyshev(each), self._variance(each, np.column_stack(variances))

    def predict_mean(self, x: ArrayLike) -> Array:
        """Return the mean (m,) alone at x (m, d)."""
        return self.chebyshev(self._means(x))

    def predict_reinterpolated(self, x: ArrayLike) -> tuple[Array, Array]:
        """Return as `predict`, with a variance of 0 at `points`."""
        mean, variance = self.predict(x)
        return mean, np.where(self.costs[0].evaluated(x), 0.0, variance)

    def variance_of_run(self, x: ArrayLike) -> Array:
        """Return the variance (m,) of the cost of one run in a drawn context at x (m, d)."""
        variances = np.column_stack([cost.variance_of_run(x) for cost in self.costs])
        return self._variance(self._means(x), variances)

    def _means(self, x: ArrayLike) -> Array:
        return np.column_stack([cost.predict_mean(x) for cost in self.costs])

    def _variance(self, means: Array, variances: Array) -> Array:
        """Return the variance (m,) of the cost, by means and variances (m, k) of the k costs."""
        variance: Array = (self.chebyshev.gradient(means) ** 2 * variances).sum(axis=1)
        return variance
