"""Scenario loop: tune for some plants, find the worst plant, add it, and repeat.

As MATLAB's `systune` is used for robust tuning: a good local optimizer tunes for a finite set of
plants, all of which must keep the limits; the worst plant of the result is sought and joins the
set. The local optimizer is COBYQA (Ragonneau and Zhang 2024), the trust-region method for
nonlinear constraints, with its documented defaults but for the radii, which suit the unit cube and
stop where noise would lead it astray. (SciPy's copy holds a lock while it runs, so that a second
loop could not begin; hence the package of its authors.) `systune` itself uses gradients of linear
models, which a measured plant does not have.

Plants
    At first a few drawn contexts. Their mean cost is the objective in every round; all plants must
    keep the limit. A limit on single runs is tightened by Φ⁻¹(probability) times the pooled
    standard deviation of repeated runs.
Start
    The best initial sample: lowest cost among those that kept the limit wherever they were run.
Worst plant
    From the worst plant of the set, each context variable in turn is moved to both of its ends.
Failed runs
    Count as the largest cost and excess so far.
Recommendation
    The lowest cost among the points run in all plants of the set, whose mean over all runs in each
    of them keeps the limit; else the one that exceeds it least.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
from cobyqa import minimize
from greenlet import getcurrent, greenlet
from scipy.optimize import Bounds, NonlinearConstraint

from bo_tuner.numerics.arrays import Array
from bo_tuner.study.study import Study
from bo_tuner.trials import Context, Value
from tuning_benchmark.peers.optimizer import tuned
from tuning_benchmark.peers.robust import Result, worst_case_constraint

DRAWN = 3
INITIAL_RADIUS, FINAL_RADIUS = 0.15, 0.02
"""Of the trust region, in edges of the unit cube; each round starts at half of the last one's."""

Key = tuple[Any, ...]


class ScenarioLoop:
    """COBYQA on a growing set of plants.

    The loop is a function that asks for runs wherever it needs one; a greenlet turns it into ask
    and tell.
    """

    def __init__(self, study: Study, seed: int) -> None:
        self._study = study
        self._space = study.search_space()
        self._contexts = study.context_space()
        drawn = self._contexts.draw_stratified(DRAWN, np.random.default_rng(seed))
        self._drawn = [self._contexts.to_dict(row) for row in drawn]
        self._plants: list[Context] = list(self._drawn)
        self._runs: dict[Key, dict[Key, list[Result]]] = {}
        self._points: dict[Key, Mapping[str, Value]] = {}
        self._largest = [0.0, 0.0]
        self._loop: greenlet | None = None
        self._latest: Result | None = None

    def ask(self) -> tuple[Mapping[str, Value], Context]:
        """Let the loop go on to its next run."""
        if self._loop is None:
            self._loop = greenlet(self._rounds)
        asked: tuple[Mapping[str, Value], Context] = self._loop.switch(self._latest)
        return asked

    def tell(self, result: Result) -> None:
        """Keep a result, for the loop to go on with."""
        key = self._space.key(result.parameters)
        self._points[key] = result.parameters
        self._runs.setdefault(key, {}).setdefault(_key(result.context), []).append(result)
        if result.cost is not None and result.excess is not None:
            self._largest = [
                max(self._largest[0], result.cost), max(self._largest[1], result.excess),
            ]  # fmt: skip
        self._latest = result

    def recommend(self) -> Mapping[str, Value] | None:
        """Return the best point that was run in all plants."""
        plants = {_key(plant) for plant in self._plants}
        complete = [key for key, runs in self._runs.items() if plants <= set(runs)]
        judged = {key: self._judged(key) for key in complete or self._runs}
        if not judged:
            return None
        kept = {key: cost for key, (cost, excess) in judged.items() if excess <= 0.0}
        if kept:
            return self._points[min(kept, key=kept.__getitem__)]
        return self._points[min(judged, key=lambda key: judged[key][1])]

    def _rounds(self, _: object) -> None:
        """Tune, find the worst plant, add it, and repeat."""
        radius = INITIAL_RADIUS
        point = self._start()
        while True:
            point = self._tune(point, max(radius, 2.0 * FINAL_RADIUS))
            worst = self._worst_plant(point)
            if _key(worst) not in {_key(plant) for plant in self._plants}:
                self._plants.append(worst)
            radius /= 2.0

    def _start(self) -> Array:
        judged = {key: self._judged(key) for key in self._runs}
        if not judged:
            return np.full(self._space.dimension, 0.5)
        best = min(judged, key=lambda key: (max(judged[key][1], 0.0), judged[key][0]))
        start: Array = self._space.to_cube(self._points[best])
        return start

    def _tune(self, start: Array, radius: float) -> Array:
        """Run COBYQA for the present plants."""
        known: dict[bytes, tuple[float, float]] = {}

        def both(x: Array) -> tuple[float, float]:
            clipped = np.clip(x, 0.0, 1.0)
            if clipped.tobytes() not in known:
                results = [self._run(clipped, plant) for plant in self._plants]
                costs = [self._numbers(result)[0] for result in results[:DRAWN]]
                excesses = [self._numbers(result)[1] for result in results]
                known[clipped.tobytes()] = float(np.mean(costs)), max(excesses) + self._margin()
            return known[clipped.tobytes()]

        minimum = minimize(
            lambda x: both(x)[0],
            start,
            bounds=Bounds(np.zeros(len(start)), np.ones(len(start))),
            constraints=NonlinearConstraint(lambda x: both(x)[1], -np.inf, 0.0),
            options={"radius_init": radius, "radius_final": FINAL_RADIUS},
        )
        best: Array = np.clip(minimum.x, 0.0, 1.0)
        return best

    def _worst_plant(self, x: Array) -> Context:
        """Search for a context worse than those of the plants, one variable after the other."""
        excesses = [(self._numbers(self._run(x, plant))[1], plant) for plant in self._plants]
        largest, worst = max(excesses, key=lambda pair: pair[0])
        for name, variable in self._study.contexts.items():
            for end in (variable.distribution.lower, variable.distribution.upper):
                tried = {**worst, name: end}
                if tried == worst:
                    continue
                excess = self._numbers(self._run(x, tried))[1]
                if excess > largest:
                    largest, worst = excess, tried
        return worst

    def _run(self, x: Array, context: Context) -> Result:
        parameters = tuned(self._space, self._space.to_parameters(self._space.repair(x[None])[0]))
        result: Result = getcurrent().parent.switch((parameters, dict(context)))
        return result

    def _numbers(self, result: Result) -> tuple[float, float]:
        if result.cost is None or result.excess is None:
            return self._largest[0], max(self._largest[1], 0.1)
        return result.cost, result.excess

    def _judged(self, key: Key) -> tuple[float, float]:
        """Mean cost of a point over its contexts, and its largest mean excess in one of them."""
        runs = [[self._numbers(r) for r in results] for results in self._runs[key].values()]
        means = np.array([np.mean(pairs, axis=0) for pairs in runs])
        return float(means[:, 0].mean()), float(means[:, 1].max()) + self._margin()

    def _margin(self) -> float:
        """Margin of a limit on single runs, from contexts that were run more than once."""
        constraint = worst_case_constraint(self._study)
        if constraint.deviations == 0.0:
            return 0.0
        squares, count = 0.0, 0
        for contexts in self._runs.values():
            for results in contexts.values():
                values = [r.excess for r in results if r.excess is not None]
                if len(values) > 1:
                    squares += float(np.var(values)) * len(values)
                    count += len(values) - 1
        return constraint.deviations * float(np.sqrt(squares / count)) if count else 0.0


def _key(context: Context) -> Key:
    return tuple(sorted(context.items()))
