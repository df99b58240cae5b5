"""CMA-ES (Hansen and Ostermeier 2001) of `cma` (pycma), by ask and tell.

Sources
    https://cma-es.github.io/apidocs-pycma/ : `CMAEvolutionStrategy`, `CMAOptions` and
    `ConstrainedFitnessAL` (augmented Lagrangian, Atamna, Auger and Hansen 2017).
Coordinates
    The unit cube, where a parameter on the logarithmic scale of the study is the logarithm, as for
    every other optimizer; integers on the linear scale in own units, since option
    ``integer_variables`` rounds to whole numbers. Option ``CMA_stds`` gives all coordinates the
    same initial step relative to their range, a quarter of it as the documentation advises.
Noise
    None of the documented handling: `NoiseHandler` evaluates solutions again, and the budgets here
    are five to seven generations.
Initial samples
    The best of them, by feasibility and then objective, is the first mean; all of them set the
    Lagrangian's coefficients. A strategy without a memory of points has no other use for them.
Constraints
    `ConstrainedFitnessAL`, which gets its values from the trials of a whole generation and adapts
    its coefficients after it. The search is a local one; the budgets here leave no restarts.
Failed trials
    Rank last in their generation. The documented alternative is to sample again; that costs
    evaluations and learns nothing, while the strategy sees only ranks, so that the size of the
    value does not matter.
Recommendation
    `ConstrainedFitnessAL.best_feas`, the best feasible solution so far, here of all observations.
    The documented favourite, the distribution's mean, was never run.
"""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager

import cma
import numpy as np

from bo_tuner.numerics.arrays import Array
from bo_tuner.study.study import Study
from bo_tuner.trials import Value
from tuning_benchmark.peers.optimizer import Observation, best_observed, excesses, permitted, tuned

# Its Lagrangian makes log files in the working folder, whatever its options; this is how its source
# says that one turns them off.
cma.constraints_handler._Logger = cma.logger.LoggerDummy

INITIAL_STEP = 0.25
"""Of a coordinate's range."""


class CmaEs:
    """CMA-ES with an augmented Lagrangian."""

    def __init__(self, study: Study, seed: int) -> None:
        self._study = study
        self._space = study.search_space()
        self._observations: list[Observation] = []
        self._fitness = cma.ConstrainedFitnessAL(
            self._objective, self._constraints, logging=0, archives=False
        )
        self._strategy: cma.CMAEvolutionStrategy | None = None
        self._generation: list[Array] = []
        self._results: list[Observation] = []
        self._random_state = np.random.RandomState(seed).get_state()
        # In own units; other integers are on a scale that does not take whole steps.
        linear = [study.parameters[name].scale != "log" for name in self._space.names]
        self._whole = self._space.integer & np.array(linear, dtype=bool)

    def ask(self) -> dict[str, Value]:
        """Take the next of the generation; after its last one, sample another generation."""
        with self._own_random_numbers():
            if self._strategy is None:
                self._strategy = self._start()
            if len(self._results) == len(self._generation):
                if self._generation:
                    fitness = self._evaluate(self._generation, self._results)
                    self._strategy.tell(self._generation, fitness)
                    self._fitness.update(self._strategy)
                self._generation, self._results = self._strategy.ask(), []
        return self._parameters(self._generation[len(self._results)])

    def tell(self, observation: Observation) -> None:
        """Take an initial sample, or the result of the one that was asked for."""
        self._observations.append(observation)
        if self._strategy is not None:
            self._results.append(observation)

    def recommend(self) -> int | None:
        """Best feasible observation."""
        return best_observed(self._observations)

    def _start(self) -> cma.CMAEvolutionStrategy:
        """Start at the best observation, with the Lagrangian's coefficients from all of them."""
        space = self._space
        points = [self._coordinates(o.parameters) for o in self._observations]
        fitness = self._evaluate(points, self._observations)
        best = best_observed(self._observations)
        if best is None and points:
            best = int(np.argmin(fitness))
        middle = space.to_parameters(np.full(space.dimension, 0.5))
        start = self._coordinates({name: middle[name] for name in space.names})
        lower = np.where(self._whole, space.lower, 0.0)
        upper = np.where(self._whole, space.upper, 1.0)
        strategy = cma.CMAEvolutionStrategy(
            start if best is None else points[best],
            INITIAL_STEP,
            {
                "bounds": [lower.tolist(), upper.tolist()],
                "CMA_stds": upper - lower,
                "integer_variables": np.flatnonzero(self._whole).tolist(),
                # The seed is in numpy's global state, see _own_random_numbers.
                "seed": np.nan,
                "verbose": -9,
                "verb_log": 0,
            },
        )
        self._fitness.update(strategy)
        return strategy

    def _evaluate(self, points: list[Array], results: list[Observation]) -> list[float]:
        """Fitness of trials at `points`, the smaller the better; failed ones come last."""
        fitness = []
        for point, observation in zip(points, results, strict=True):
            self._result = observation
            fitness.append(np.inf if observation.failed else float(self._fitness(point)))
        last = max((f for f in fitness if np.isfinite(f)), default=0.0) + 1.0
        return [f if np.isfinite(f) else last for f in fitness]

    def _objective(self, point: Array) -> float:
        objective = self._result.objective
        return np.nan if objective is None else objective

    def _constraints(self, point: Array) -> list[float]:
        # Without a constraint, one that always holds.
        return list(excesses(self._study, self._result).values()) or [-1.0]

    def _coordinates(self, parameters: Mapping[str, Value]) -> Array:
        point = self._space.to_cube(parameters)
        for column in np.flatnonzero(self._whole):
            point[column] = parameters[self._space.names[column]]
        return point

    def _parameters(self, point: Array) -> dict[str, Value]:
        whole = self._whole
        values = self._space.to_parameters(np.where(whole, 0.5, point))
        rounded = {
            name: int(np.rint(point[column]))
            for column, name in enumerate(self._space.names)
            if whole[column]
        }
        return permitted(self._space, tuned(self._space, values) | rounded)

    @contextmanager
    def _own_random_numbers(self) -> Iterator[None]:
        """Exchange numpy's global state, from which `cma` draws, for ours."""
        outside = np.random.get_state()  # noqa: NPY002
        np.random.set_state(self._random_state)  # noqa: NPY002
        try:
            yield
        finally:
            self._random_state = np.random.get_state()  # noqa: NPY002
            np.random.set_state(outside)  # noqa: NPY002
