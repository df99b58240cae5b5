"""Published robust optimizers by confidence bounds: StableOpt, and CARBO for an expected cost.

Both choose the parameters by an optimistic bound of what the worst context makes of them, and then
the context by a pessimistic one; each iteration is one evaluation. No package that can be installed
has them, so they are implemented here, on the Gaussian process of the tuner over parameters x and
context w jointly, with bounds μ ± 2 σ.

StableOpt (Bogunovic, Scarlett, Jegelka and Cevher 2018, NeurIPS, Alg. 1 and Sec. 4, robustness to
unknown parameters), for min_x max_w v(x, w):

    x_t = argmin_x max_w lcb(x, w),   w_t = argmax_w ucb(x_t, w),

    and recommends the evaluated x with the least max_w ucb. It knows no constraints and no
    expectation, so v is the cost plus a penalty, and the cost's worst context counts, too.

CARBO (Kudva, Sorourifar and Paulson 2022, AIChE Journal 68:e17857), for min_x max_w f under
max_w g ≤ 0, models f and g apart and minimizes an exact penalty function of their bounds. Here f is
the mean of the cost over drawn contexts, as the study's objective is:

    x_t = argmin_x  mean_w lcb_f + ρ max(0, max_w lcb_g),

    w_t is where ucb_g is largest while that exceeds the limit, for then x_t is not known to be
    feasible, and else the drawn context where the cost is least certain. It recommends the
    evaluated x with the least pessimistic value, by ucb in place of lcb.

A limit on single runs is met by the mean plus Φ⁻¹(probability) times the model's noise. A failed
evaluation, which neither publication knows, counts as the largest cost and excess so far.
"""

from abc import ABC, abstractmethod
from collections.abc import Mapping

import numpy as np

from bo_tuner.models.context_maximum import maximize_over_contexts
from bo_tuner.models.gaussian_process import GaussianProcess
from bo_tuner.models.hyperpriors import Hyperparameters
from bo_tuner.numerics.arrays import Array
from bo_tuner.numerics.particle_swarm import SwarmSettings, maximize
from bo_tuner.study.study import Study
from bo_tuner.trials import Context, Value
from tuning_benchmark.peers.optimizer import tuned
from tuning_benchmark.peers.robust import Result, worst_case_constraint

DEVIATIONS = 2.0
"""√β: standard deviations of a confidence bound; both papers' experiments use a constant."""

PENALTY = 5.0
"""ρ: cost of exceeding the limit by as much as its size.

An exact penalty must exceed the constraint's multiplier; the cost is on the logarithmic scale.
"""

SWARM = SwarmSettings(particles=30, iterations=20, stall=6)

DRAWN, CORNERS, REMEMBERED = 6, 16, 8
"""Contexts of the expectation; corners, at most, and latest worst contexts for a maximum over w.

The context to evaluate is sought in the whole box.
"""

REFIT = 5
"""Evaluations after which the hyperparameters are fitted again."""


class ConfidenceBounds(ABC):
    """Joint models of responses, and the search of parameters and context by their bounds."""

    def __init__(self, study: Study, seed: int) -> None:
        self._study = study
        self._space = study.search_space()
        self._contexts = study.context_space()
        self._seed = seed
        self._results: list[Result] = []
        self._models: list[GaussianProcess] = []
        self._fitted = 0
        self._starts: list[tuple[float, ...]] = []
        self._hyperparameters: list[Hyperparameters] = []
        rng = np.random.default_rng(seed)
        drawn = self._contexts.draw_stratified(DRAWN, rng)
        self._drawn = self._contexts.to_cube(drawn)
        nominal = self._contexts.to_cube(self._contexts.nominal()[None])
        corners = rng.permutation(self._contexts.corners())[:CORNERS]
        self._fixed = np.vstack([corners, nominal])
        self._asked_contexts: list[Array] = []

    def tell(self, result: Result) -> None:
        """Keep a result."""
        self._results.append(result)
        self._models = []

    def ask(self) -> tuple[Mapping[str, Value], Context]:
        """Minimize the optimistic value, then choose the context."""
        rng = np.random.default_rng((self._seed, len(self._results)))
        self._condition(rng)
        evaluated = self._evaluated()
        order = np.argsort(self._value(evaluated, -DEVIATIONS), kind="stable")
        maximum = maximize(
            lambda x: -self._value(x, -DEVIATIONS),
            self._space.dimension,
            rng,
            repair=self._space.repair,
            initial=evaluated[order[:5]],
            settings=SWARM,
        )
        parameters = tuned(self._space, self._space.to_parameters(maximum.position))
        context = self._context(self._space.to_cube(parameters), rng)
        self._asked_contexts.append(self._contexts.cube_of([context])[0])
        return parameters, context

    def recommend(self) -> Mapping[str, Value] | None:
        """Return the evaluated parameters with the least pessimistic value."""
        if not self._results:
            return None
        self._condition(np.random.default_rng((self._seed, len(self._results))))
        best = int(np.argmin(self._value(self._evaluated(), DEVIATIONS)))
        return self._results[best].parameters

    @abstractmethod
    def _responses(self) -> list[Array]:
        """Modelled responses (n,) of all evaluations, NaN where one failed."""

    @abstractmethod
    def _value(self, x: Array, deviations: float) -> Array:
        """Value (m,) of points x (m, d) with all responses at a bound."""

    @abstractmethod
    def _context(self, x: Array, rng: np.random.Generator) -> Context:
        """Context of the next evaluation at a point (d,)."""

    def _bound(self, model: int, x: Array, w: Array, deviations: float) -> Array:
        """Bound (m, k) of a response at points (m, d) in contexts (k, e)."""
        joint = np.hstack([np.repeat(x, len(w), axis=0), np.tile(w, (len(x), 1))])
        mean, variance = self._models[model].predict(joint)
        bound: Array = (mean + deviations * np.sqrt(variance)).reshape(len(x), len(w))
        return bound

    def _largest_bound(self, model: int, x: Array, rng: np.random.Generator) -> Context:
        """Context where the upper bound of a response at a point (d,) is largest."""
        context, _ = maximize_over_contexts(
            self._contexts,
            lambda w: self._bound(model, x[None], w, DEVIATIONS)[0],
            rng,
            np.array(self._asked_contexts[-REMEMBERED:]).reshape(-1, self._contexts.dimension),
        )
        return context

    @property
    def _candidates(self) -> Array:
        """Contexts (k, e) over which a maximum is taken."""
        return np.vstack([self._fixed, *(w[None] for w in self._asked_contexts[-REMEMBERED:])])

    def _evaluated(self) -> Array:
        return self._space.cube_of(r.parameters for r in self._results)

    def _condition(self, rng: np.random.Generator) -> None:
        """Bring the models up to date."""
        if self._models:
            return
        w = self._contexts.cube_of([r.context for r in self._results])
        joint = np.hstack([self._evaluated(), w])
        again = self._fitted == 0 or len(self._results) >= self._fitted + REFIT
        for index, response in enumerate(self._responses()):
            largest = np.nanmax(response) if np.isfinite(response).any() else 0.0
            y = np.where(np.isnan(response), largest, response)
            if again:
                start = self._starts[index] if self._fitted else None
                model = GaussianProcess.fit(joint, y, rng=rng, start=start)
            else:
                model = GaussianProcess.condition(self._hyperparameters[index], joint, y)
            self._models.append(model)
        if again:
            self._fitted = len(self._results)
            self._starts = [model.warm_start for model in self._models]
            self._hyperparameters = [model.hyperparameters for model in self._models]

    @property
    def _noise_margin(self) -> float:
        return worst_case_constraint(self._study).deviations

    def _cost(self) -> Array:
        return np.array([np.nan if r.cost is None else r.cost for r in self._results])

    def _excess(self) -> Array:
        return np.array([np.nan if r.excess is None else r.excess for r in self._results])


class StableOpt(ConfidenceBounds):
    """StableOpt on the cost with a penalty."""

    def _responses(self) -> list[Array]:
        return [self._cost() + PENALTY * np.maximum(self._excess(), 0.0)]

    def _value(self, x: Array, deviations: float) -> Array:
        worst: Array = self._bound(0, x, self._candidates, deviations).max(axis=1)
        return worst

    def _context(self, x: Array, rng: np.random.Generator) -> Context:
        return self._largest_bound(0, x, rng)


class Carbo(ConfidenceBounds):
    """CARBO with an expected cost."""

    def _responses(self) -> list[Array]:
        return [self._cost(), self._excess()]

    def _value(self, x: Array, deviations: float) -> Array:
        expected = self._bound(0, x, self._drawn, deviations).mean(axis=1)
        worst = self._bound(1, x, self._candidates, deviations).max(axis=1) + self._margin
        value: Array = expected + PENALTY * np.maximum(worst, 0.0)
        return value

    def _context(self, x: Array, rng: np.random.Generator) -> Context:
        worst = self._largest_bound(1, x, rng)
        upper = self._bound(1, x[None], self._contexts.cube_of([worst]), DEVIATIONS)
        if float(upper[0, 0]) + self._margin > 0.0:
            return worst
        spread = self._bound(0, x[None], self._drawn, 1.0) - self._bound(0, x[None], self._drawn, 0)
        row = self._contexts.to_contexts(self._drawn[[int(np.argmax(spread))]])[0]
        return self._contexts.to_dict(row)

    @property
    def _margin(self) -> float:
        return float(self._noise_margin * np.sqrt(self._models[1].noise_variance))
