"""Stage two of the paper: the worst context of one parameter set (Sec. 4.2)."""

from collections.abc import Callable, Sequence

import numpy as np

from bo_tuner.models.context_maximum import maximize_over_contexts
from bo_tuner.models.gaussian_process import GaussianProcess
from bo_tuner.numerics.arrays import Array
from bo_tuner.numerics.special import log_expected_improvement
from bo_tuner.study.context_space import ContextSpace
from bo_tuner.trials import Context, WorstCase
from bo_tuner.worst_case.contexts import PRIORS

OBSERVED, POSTERIOR = "observed", "posterior"


class ReinterpolationSearch:
    """Bayesian optimization of the context that maximizes a metric of one parameter set.

    It returns the starting contexts first, then those that maximize the expected improvement under
    the reinterpolation model of all evaluations. It ends when the limit is violated, or when all
    evaluations are used.

    Parameters
    ----------
    space
        The context space.
    limit
        Upper limit of the metric, in its unit.
    evaluations
        Largest number of contexts that `ask` returns.
    estimate
        ``observed``, the estimate of the paper: a single observation above the limit violates it,
        and the worst case is the largest observation. Its upward bias grows with the number of
        evaluations. ``posterior``: the limit is violated if the posterior mean exceeds it by a
        standard deviation in an evaluated context, and the worst case is the largest posterior mean
        over all contexts.
    starts
        Starting contexts, the worst of neighbouring parameter sets; all are evaluated.
    """

    def __init__(
        self,
        space: ContextSpace,
        limit: float,
        evaluations: int,
        estimate: str = POSTERIOR,
        starts: Sequence[Context] = (),
    ) -> None:
        self._space = space
        self._limit = limit
        self._evaluations = evaluations if space.dimension > 0 else 0
        self._estimate = estimate
        self._starts = [dict(start) for start in starts[: self._evaluations]]
        self._contexts: list[Array] = []
        self._values: list[float] = []
        self._asked = 0

    def tell(self, context: Context, value: float) -> None:
        """Add an evaluation: its context and the constrained metric."""
        self._contexts.append(self._space.rows([context])[0])
        self._values.append(value)

    def done(self, rng: np.random.Generator) -> bool:
        """Return whether all evaluations are used or the limit is violated."""
        if self._asked >= self._evaluations:
            return True
        if self._starts:
            return False
        if max(self._values) <= self._limit or self._estimate == OBSERVED:
            return max(self._values) > self._limit
        model = self._fit(rng)
        mean, variance = model.predict(model.data.x)
        return bool((mean - np.sqrt(variance)).max() > self._limit)

    def ask(self, rng: np.random.Generator) -> Context:
        """Return the next context to evaluate.

        If no improvement is expected in any context, it is the one farthest from all evaluated
        ones.
        """
        self._asked += 1
        if self._starts:
            return self._starts.pop(0)
        model = self._fit(rng)
        lowest = -float(model.predict(model.data.x)[0].max())

        def acquisition(x: Array) -> Array:
            mean, variance = model.predict_reinterpolated(x)
            return log_expected_improvement(-mean, variance, lowest)

        def distance(x: Array) -> Array:
            squared = ((x[:, None, :] - model.data.x[None, :, :]) ** 2).sum(axis=2)
            nearest: Array = squared.min(axis=1)
            return nearest

        context, value = self._maximize(acquisition, rng)
        if not np.isfinite(value):
            context, _ = self._maximize(distance, rng)
        return context

    def worst_case(self, rng: np.random.Generator) -> WorstCase:
        """Estimate the worst case from all evaluations so far."""
        top = int(np.argmax(self._values))
        observed = self._values[top]
        if self._estimate == OBSERVED:
            return WorstCase(observed, self._space.to_dict(self._contexts[top]), observed)
        if self._space.dimension == 0:
            # The only context there is: its mean and noise are those of the sample.
            noise = float(np.std(self._values, ddof=1)) if len(self._values) > 1 else 0.0
            return WorstCase(float(np.mean(self._values)), {}, observed, noise)
        model = self._fit(rng)
        context, value = self._maximize(model.predict_mean, rng)
        return WorstCase(value, context, observed, model.noise_variance**0.5)

    def _fit(self, rng: np.random.Generator) -> GaussianProcess:
        x = self._space.to_cube(np.array(self._contexts))
        return GaussianProcess.fit(x, np.array(self._values), rng=rng, priors=PRIORS)

    def _maximize(
        self, function: Callable[[Array], Array], rng: np.random.Generator
    ) -> tuple[Context, float]:
        tried = self._space.to_cube(np.array(self._contexts))
        return maximize_over_contexts(self._space, function, rng, tried)
