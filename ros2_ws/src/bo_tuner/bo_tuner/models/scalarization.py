"""Several objectives as one cost: the augmented Chebyshev scalarization of ParEGO.

With the costs f_1 ... f_k less those of the utopian point, in units of the front seen from its
ideal to its nadir point, Knowles (2006, Eq. 2) minimizes

    f_w(x) = max_j w_j f_j(x) + ρ Σ_j w_j f_j(x)

with weights w, drawn anew for each proposal. Each point of the Pareto front, also where that is not
convex, is the minimum for some weights (Miettinen 1999, Sec. 3.4.5); the sum excludes points that
are only weakly optimal. With equal weights the minimum is the compromise: the point of the front
nearest to the ideal one in this metric (Zeleny 1973). Limits stay apart: they are the constraints
of the acquisition function.

The utopian point is better than the ideal one, by the same part of the front's width in each
objective (Miettinen 1999, Sec. 2.4.2). With the ideal point of what was seen the minimum is never
beyond the ends of that, whatever the weights, and the front found would not grow. The compromise is
the same with either.

The objectives are means over contexts and noise, so the cost is that of the means, not the mean of
the costs of single evaluations, which would be too large: a maximum of noise is on average above
zero. Where one process models f_w of trials (`linearized`), each evaluation enters by the
linearization of f_w about the mean of its trial. The mean of these values is f_w of the mean, and
their scatter is the noise that the process estimates. With a process for each objective, f_w is one
of their posterior means (`bo_tuner.models.scalarized_objective`).

Notation: n trials, k objectives, m evaluations of a trial.

References
----------
Knowles (2006). ParEGO: a hybrid algorithm with on-line landscape approximation for expensive
multiobjective optimization problems. IEEE Transactions on Evolutionary Computation 10(1).
Miettinen (1999). Nonlinear multiobjective optimization. Kluwer.
Zeleny (1973). Compromise programming. In Cochrane and Zeleny (eds.), Multiple criteria decision
making. University of South Carolina Press.
"""

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from bo_tuner.numerics.arrays import Array
from bo_tuner.numerics.pareto import nondominated

AUGMENTATION = 0.05
"""ρ of Knowles (2006)."""

BEYOND = 0.3
"""Part of the front's width by which the utopian point is better than the ideal one."""


LEANING = 0.5
"""Part of the weight that one objective has alone, where the others share the rest with it."""


def equal_weights(count: int) -> Array:
    """Return the weights (k,) of the compromise between `count` objectives."""
    return np.full(count, 1.0 / count)


def leaning_weights(count: int) -> Array:
    """Return weights (k, k) that lean towards one of `count` objectives each."""
    weights: Array = LEANING * np.eye(count) + (1.0 - LEANING) * equal_weights(count)
    return weights


@dataclass(frozen=True, eq=False)
class Chebyshev:
    """The scalarization f_w.

    Attributes
    ----------
    weights : ndarray, shape (k,)
        w, not negative, of sum 1.
    ideal, nadir : ndarray, shape (k,)
        Least and largest costs on the front seen; nadir > ideal.
    """

    weights: Array
    ideal: Array
    nadir: Array

    @classmethod
    def between(cls, means: Array, feasible: NDArray[np.bool_], weights: Array) -> Self:
        """Scale by the front of the feasible points, or by half of all points where that is wider.

        Parameters
        ----------
        means : ndarray, shape (n, k)
            Mean costs of the trials.
        feasible : ndarray of bool, shape (n,)
            Which of them are believed feasible; without any, all count.
        weights : ndarray, shape (k,)
            w, not negative, of sum 1.
        """
        known = means[feasible] if feasible.any() else means
        front = known[nondominated(known)]
        ideal = front.min(axis=0)
        # A point that is better than almost all in every cost is alone on the front, or nearly so.
        nadir = np.maximum(front.max(axis=0), np.median(means, axis=0))
        for further in (known, means):
            nadir = np.where(nadir > ideal, nadir, further.max(axis=0))
        # Adding 1 to a large number may not change it.
        wide = ideal + np.maximum(1.0, 1e-9 * np.abs(ideal))
        return cls(weights, ideal, np.where(nadir > ideal, nadir, wide))

    def __call__(self, costs: Array) -> Array:
        """Return f_w (n,) of mean costs (n, k)."""
        weighted = self._weighted(costs)
        total: Array = weighted.max(axis=1) + AUGMENTATION * weighted.sum(axis=1)
        return total

    def gradient(self, costs: Array) -> Array:
        """Return the derivatives (n, k) of f_w by the costs at mean costs (n, k)."""
        weighted = self._weighted(costs)
        largest = np.arange(len(self.weights)) == weighted.argmax(axis=1)[:, None]
        gradient: Array = self.weights / (self.nadir - self.ideal) * (AUGMENTATION + largest)
        return gradient

    def linearized(self, costs: Array) -> Array:
        """Return values (m,) for the costs (m, k) of a trial's evaluations; their mean is f_w."""
        weighted = self._weighted(costs)
        largest = int(weighted.mean(axis=0).argmax())
        values: Array = weighted[:, largest] + AUGMENTATION * weighted.sum(axis=1)
        return values

    def _weighted(self, costs: Array) -> Array:
        scaled: Array = (costs - self.ideal) / (self.nadir - self.ideal) + BEYOND
        return self.weights * scaled
