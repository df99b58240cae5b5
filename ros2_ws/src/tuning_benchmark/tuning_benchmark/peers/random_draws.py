"""Random search (Bergstra and Bengio 2012): independent uniform draws, no model.

The draw is the one of the search space: all integers are equally likely, doubles uniform on their
own scale, values in the wrong order exchanged. What it would use is the best feasible observation.
"""

import numpy as np

from bo_tuner.study.study import Study
from bo_tuner.trials import Value
from tuning_benchmark.peers.optimizer import Observation, best_observed, tuned


class Random:
    """Uniform draws."""

    def __init__(self, study: Study, seed: int) -> None:
        self._space = study.search_space()
        self._rng = np.random.default_rng(seed)
        self._observations: list[Observation] = []

    def ask(self) -> dict[str, Value]:
        """Draw a parameter set."""
        cube = self._space.latin_hypercube(1, self._rng)[0]
        return tuned(self._space, self._space.to_parameters(cube))

    def tell(self, observation: Observation) -> None:
        """Keep an observation."""
        self._observations.append(observation)

    def recommend(self) -> int | None:
        """Best feasible observation."""
        return best_observed(self._observations)
