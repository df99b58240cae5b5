"""Stage two of the paper: the worst context of one parameter set (Sec. 4.2)."""

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from bo_tuner.models.gaussian_process import GaussianProcess
from bo_tuner.numerics.arrays import Array
from bo_tuner.numerics.special import log_expected_improvement
from bo_tuner.study.context_space import ContextSpace
from bo_tuner.trials import WorstCase
from bo_tuner.worst_case.contexts import PRIORS, maximise_over_contexts

OBSERVED, POSTERIOR = "observed", "posterior"


class ReinterpolationSearch:
    """Bayesian search of the context that maximises one metric of a parameter set.

    It builds on whatever contexts it is told, tries given starting contexts, then maximises the
    reinterpolation expected improvement. It ends when the limit is violated or all evaluations are
    used.

    Parameters
    ----------
    space
        The contexts.
    limit
        Upper limit of the metric.
    evaluations
        Most contexts that `ask` will give.
    estimate
        ``observed``, as in the paper: the limit is violated by a single observation above it, and
        the worst case is the largest observation, which noise biases upwards by more, the more
        evaluations there are. ``posterior``: violated where the posterior mean is a standard
        deviation above it, and the worst case is the largest posterior mean over all contexts.
    starts
        Contexts that were the worst for neighbouring parameter sets; tried first in any case.
    """

    def __init__(
        self,
        space: ContextSpace,
        limit: float,
        evaluations: int,
        estimate: str = POSTERIOR,
        starts: Sequence[Mapping[str, float]] = (),
    ) -> None:
        self._space = space
        self._limit = limit
        self._evaluations = evaluations if space.dimension > 0 else 0
        self._estimate = estimate
        self._starts = [dict(start) for start in starts[: self._evaluations]]
        self._contexts: list[Array] = []
        self._values: list[float] = []
        self._asked = 0

    def tell(self, context: Mapping[str, float], value: float) -> None:
        """Take note of an evaluation: its context and the metric."""
        self._contexts.append(np.array([context[name] for name in self._space.names]))
        self._values.append(value)

    def done(self, rng: np.random.Generator) -> bool:
        """Whether nothing is left to ask: all evaluations are used, or the limit is violated."""
        if self._asked >= self._evaluations:
            return True
        if self._starts:
            return False
        if max(self._values) <= self._limit or self._estimate == OBSERVED:
            return max(self._values) > self._limit
        model = self._fit(rng)
        mean, variance = model.predict(model.data.x)
        return bool((mean - np.sqrt(variance)).max() > self._limit)

    def ask(self, rng: np.random.Generator) -> dict[str, float]:
        """Give the next context.

        Where the model leaves no improvement to expect, it is the context that is farthest from
        all that were tried.
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

        context, value = self._maximise(acquisition, rng)
        if not np.isfinite(value):
            context, _ = self._maximise(distance, rng)
        return context

    def worst_case(self, rng: np.random.Generator) -> WorstCase:
        """Estimate the worst case from all that was told."""
        top = int(np.argmax(self._values))
        observed = self._values[top]
        if self._estimate == OBSERVED or self._space.dimension == 0:
            return WorstCase(observed, self._space.to_dict(self._contexts[top]), observed)
        model = self._fit(rng)
        context, value = self._maximise(model.predict_mean, rng)
        return WorstCase(value, context, observed, model.noise_variance**0.5)

    def _fit(self, rng: np.random.Generator) -> GaussianProcess:
        x = self._space.to_cube(np.array(self._contexts))
        return GaussianProcess.fit(x, np.array(self._values), rng=rng, priors=PRIORS)

    def _maximise(
        self, function: Callable[[Array], Array], rng: np.random.Generator
    ) -> tuple[dict[str, float], float]:
        tried = self._space.to_cube(np.array(self._contexts))
        return maximise_over_contexts(self._space, function, rng, tried)
