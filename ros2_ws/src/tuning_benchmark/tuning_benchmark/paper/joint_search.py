"""Algorithm V: one Gaussian process over parameter set and context (Krause and Ong 2011).

The paper's stage two starts without data for every parameter set (Sec. 4.2, which names a joint
model as an alternative). Here one model has the evaluations of all trials as its data. The worst
case of a parameter set is the largest posterior mean over the contexts; earlier trials inform it
before the first evaluation of that parameter set.

Notation: d tuned parameters, e context variables; a joint point is (x, c), both in unit cubes.
"""

from collections.abc import Callable, Sequence
from math import sqrt

import numpy as np
from scipy.special import ndtri

from bo_tuner.models.context_maximum import maximize_over_contexts
from bo_tuner.models.gaussian_process import GaussianProcess
from bo_tuner.models.hyperpriors import Hyperparameters
from bo_tuner.numerics.arrays import Array
from bo_tuner.study.context_space import ContextSpace
from bo_tuner.trials import Context, WorstCase
from bo_tuner.worst_case.contexts import PRIORS, is_clear


class JointSearch:
    """Stage two of Algorithm V for one parameter set, with an ask-and-tell interface.

    Each evaluation maximizes the upper confidence bound of the joint model, posterior mean plus one
    standard deviation, since a violation is most likely to be found there. The search ends when the
    decision is clear, or when all evaluations are used.

    Parameters
    ----------
    space
        The context space.
    evaluations
        Largest number of contexts that `ask` returns.
    limit
        Upper limit of the metric, in its unit, without the margin for the noise of an evaluation.
    probability
        Probability with which a single evaluation in the worst context must keep the limit; 0.5 if
        the limit is on the mean over noise.
    point
        The parameter set (d,) in the unit cube.
    x, y
        Joint points (n, d + e) and values (n,) of the metric in earlier trials.
    hyperparameters
        Logarithms of the joint model's hyperparameters, length d + e + 2; by default they are
        fitted to the data.
    """

    def __init__(
        self,
        space: ContextSpace,
        limit: float,
        probability: float,
        evaluations: int,
        point: Array,
        x: Array,
        y: Array,
        hyperparameters: Sequence[float] | None = None,
    ) -> None:
        self._space = space
        self._limit = limit
        self._probability = probability
        self._evaluations = evaluations if space.dimension > 0 else 0
        self._point = point
        self._x = x
        self._y = y
        self._hyperparameters = hyperparameters
        self._model: GaussianProcess | None = None
        self._observed: list[float] = []
        self._asked = 0

    def tell(self, context: Context, value: float) -> None:
        """Add an evaluation: its context and the constrained metric."""
        self._x = np.vstack([self._x, self._joint(self._space.cube_of([context]))])
        self._y = np.append(self._y, value)
        self._observed.append(value)
        self._model = None

    def done(self, rng: np.random.Generator) -> bool:
        """Return whether all evaluations are used or the decision is clear."""
        if self._asked >= self._evaluations:
            return True
        model = self._fit(rng)
        margin = float(ndtri(self._probability)) * sqrt(model.noise_variance)
        context, _ = self._maximize(lambda c: self._upper(model, c), rng)
        mean, variance = model.predict(self._joint(self._space.cube_of([context])))
        return is_clear(self._limit - margin - float(mean[0]), float(variance[0]), self._asked)

    def ask(self, rng: np.random.Generator) -> Context:
        """Return the context with the largest upper confidence bound."""
        self._asked += 1
        model = self._fit(rng)
        return self._maximize(lambda c: self._upper(model, c), rng)[0]

    def worst_case(self, rng: np.random.Generator) -> WorstCase:
        """Estimate the worst case from all evaluations so far."""
        model = self._fit(rng)
        observed = max(self._observed)
        context, value = self._maximize(lambda c: model.predict_mean(self._joint(c)), rng)
        return WorstCase(value, context, observed, sqrt(model.noise_variance))

    def _fit(self, rng: np.random.Generator) -> GaussianProcess:
        if self._model is None:
            if self._hyperparameters is None:
                self._model = GaussianProcess.fit(self._x, self._y, rng=rng, priors=PRIORS)
            else:
                hyperparameters = Hyperparameters.from_log(np.array(self._hyperparameters))
                self._model = GaussianProcess.condition(hyperparameters, self._x, self._y)
        return self._model

    def _joint(self, c: Array) -> Array:
        return np.hstack([np.tile(self._point, (len(c), 1)), c])

    def _upper(self, model: GaussianProcess, c: Array) -> Array:
        mean, variance = model.predict(self._joint(c))
        return mean + np.sqrt(variance)

    def _maximize(
        self, function: Callable[[Array], Array], rng: np.random.Generator
    ) -> tuple[Context, float]:
        own = self._x[len(self._x) - len(self._observed) :, len(self._point) :]
        return maximize_over_contexts(self._space, function, rng, own)
