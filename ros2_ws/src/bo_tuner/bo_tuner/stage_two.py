"""Stage two: the worst context of one parametrization (Sec. 4.2), by ask and tell."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from bo_tuner.context_space import ContextSpace
from bo_tuner.particle_swarm import SwarmSettings, maximise
from bo_tuner.special import Array, log_expected_improvement
from bo_tuner.surrogate.gaussian_process import GaussianProcess
from bo_tuner.trials import WorstCase

OBSERVED, POSTERIOR = "observed", "posterior"

SEARCH_EFFORT = SwarmSettings(particles=40, iterations=25, stall=6)


@dataclass
class WorstCaseSearch:
    """Bayesian search of the context that maximises one metric of a parametrization.

    It starts from whatever contexts it is told, and ends at the first observation above the limit
    or when its cuts are used up.

    Parameters
    ----------
    space
        The contexts.
    limit
        Upper limit of the metric.
    cuts
        Most contexts that `ask` will give.
    estimate
        How `worst_case` estimates: ``observed``, the paper's maximum of the observations, which
        noise biases upwards by more, the more cuts there are; or ``posterior``, the largest
        posterior mean over all contexts.
    """

    space: ContextSpace
    limit: float
    cuts: int
    estimate: str = POSTERIOR
    _contexts: list[Array] = field(default_factory=list)
    _values: list[float] = field(default_factory=list)
    _asked: int = 0

    def tell(self, context: Mapping[str, float], value: float) -> None:
        """Take note of a cut: its context and the metric."""
        self._contexts.append(np.array([context[name] for name in self.space.names]))
        self._values.append(value)

    @property
    def done(self) -> bool:
        """Whether a violation was observed or all cuts are used up."""
        if self.space.dimension == 0 or self._asked >= self.cuts:
            return True
        return max(self._values, default=-np.inf) > self.limit

    def ask(self, rng: np.random.Generator) -> dict[str, float]:
        """Give the next context: the reinterpolation EI's choice, or the farthest if it has none.

        Once every context is explained by the model, the improvement is zero everywhere; the
        search then fills the space.
        """
        self._asked += 1
        model = self._fit(rng)
        lowest = -max(model.predict(model.data.x)[0])

        def acquisition(x: Array) -> Array:
            mean, variance = model.predict_reinterpolated(x)
            return log_expected_improvement(-mean, variance, lowest)

        found = self._maximise(acquisition, rng)
        if not np.isfinite(found[1]):
            tried = model.data.x
            found = self._maximise(
                lambda x: ((x[:, None, :] - tried[None]) ** 2).sum(axis=2).min(axis=1), rng
            )
        return self.space.to_dict(self.space.to_contexts(found[0][None])[0])

    def worst_case(self, rng: np.random.Generator) -> WorstCase:
        """Estimate the worst case from all that was told."""
        top = int(np.argmax(self._values))
        observed = self._values[top]
        if self.estimate == OBSERVED or self.space.dimension == 0:
            return WorstCase(observed, self.space.to_dict(self._contexts[top]), observed)
        model = self._fit(rng)
        position, value = self._maximise(lambda x: model.predict(x)[0], rng)
        context = self.space.to_contexts(position[None])[0]
        return WorstCase(value, self.space.to_dict(context), observed)

    def _fit(self, rng: np.random.Generator) -> GaussianProcess:
        x = self.space.to_cube(np.array(self._contexts))
        return GaussianProcess.fit(x, np.array(self._values), rng=rng)

    def _maximise(
        self, function: Callable[[Array], Array], rng: np.random.Generator
    ) -> tuple[Array, float]:
        d = self.space.dimension
        corners = np.array(np.meshgrid(*[[0.0, 1.0]] * min(d, 5))).reshape(min(d, 5), -1).T
        initial = np.hstack([corners, np.full((len(corners), d - corners.shape[1]), 0.5)])
        found = maximise(
            function,
            d,
            rng,
            repair=lambda x: self.space.to_cube(self.space.to_contexts(x)),
            initial=np.vstack([self.space.to_cube(np.array(self._contexts)), initial]),
            settings=SEARCH_EFFORT,
        )
        return found.position, found.value
