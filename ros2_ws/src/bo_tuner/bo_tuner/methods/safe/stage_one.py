"""Stage one of `safe`: grow the set that is expected to be safe, and improve within it.

The first trials are the parameter sets that the study names. Those all runs of which keep the
limits are where it starts; without any it goes no further. No model knows yet what a parameter
does, so the next ones change one number each, by `FIRST_STEP` of the way that it may travel. Each
further trial is one of the safe set within reach (`safe_set`), in turns

- the one with the largest expected improvement (Eq. 5 of the paper), and
- one that grows the set: the one whose limits are most uncertain, among those that may be better
  than the best known one. SafeOpt (Sui et al. 2015, Algorithm 1) takes the most uncertain of all
  that may enlarge the set or may be the best. Here it has to be near both, as otherwise the set is
  enlarged where nobody wants to go (Turchetta et al. 2019); and candidates lie in the direction of
  what the plain search would try.

What a broken limit changes is in `trust`. Where no parameter set within reach is expected to be
safe, the best known one is run again, since a better known noise and mean may open the way; after
`REPEATED` of these in a row the search stands still, and says which limit is in its way.

References
----------
Sui, Gotovos, Burdick and Krause (2015). Safe exploration for optimization with Gaussian processes.
ICML.
Turchetta, Berkenkamp and Krause (2019). Safe exploration for interactive machine learning. NeurIPS.
"""

from collections.abc import Iterator, Sequence
from itertools import takewhile

import numpy as np
from numpy.typing import NDArray

from bo_tuner.acquisition.acquisition import AcquisitionRule
from bo_tuner.methods.boundary.judging import PooledRanking
from bo_tuner.methods.safe.safe_set import CONFIDENCE, Reach, SafeSet
from bo_tuner.methods.safe.trust import trust_after
from bo_tuner.models.pooled_models import PooledSurrogates
from bo_tuner.numerics.arrays import Array
from bo_tuner.optimizers.base import (
    ACQUISITION,
    DEFAULT,
    EXPANSION,
    REPETITION,
    START,
    Proposal,
)
from bo_tuner.optimizers.bayesian import AcquisitionSearch, BayesianOptimization
from bo_tuner.study.limits import kept_by
from bo_tuner.study.safe_search import SafeSearch
from bo_tuner.study.study import Study
from bo_tuner.text import percent
from bo_tuner.trials import Trial, Value

FIRST_STEP = 0.1
"""Share of the largest step by which each number is changed at first; an integer by its least."""

REPEATED = 3
"""Trials in a row of known parameter sets after which the search stands still."""

CLOSE = 0.5
"""Share of the largest step, in each number, within which points are close to a refused one."""

OPTIMISM = 2.0
"""Standard deviations by which the cost may be less than its mean where the set may grow."""

TRIED_ANEW = 20
"""Best candidates of which one must not have been tried."""

NO_SAFE_START = (
    "no parameter set to start from has kept all limits in its runs: name one that does with start "
    "or --start, or narrow the contexts, or widen the limit"
)

START_REFUSED = (
    "every parameter set to start from was refused: allow one, or name others with start or --start"
)

ALL_TRIED = (
    "all parameter sets within reach that are expected to be safe have been tried: a larger "
    "safe_search.travel, a wider limit or a larger safe_search.risk would help"
)


class SafeOptimization(BayesianOptimization[PooledSurrogates]):
    """Optimizer of `safe`.

    Parameters
    ----------
    study
        The study.
    ranking
        Of the parameter sets, and with it the models.
    acquisition
        Makes the acquisition function.
    """

    def __init__(self, study: Study, ranking: PooledRanking, acquisition: AcquisitionRule) -> None:
        super().__init__(study, ranking.fit, acquisition)
        self._how = study.safe_search or SafeSearch()
        self._starts = self._starts or [self.space.defaults]
        self._in_the_way = ALL_TRIED

    def ask(self, pending: Sequence[Trial] = ()) -> Proposal | None:
        """Propose the next trial; None if none is expected to be safe."""
        self.pending = tuple(pending)
        # No design beyond these: nothing is tried that nobody knows to be safe.
        start = self.start()
        if start is not None:
            return start
        if not self._kept:
            # The sets to start from come first: one of those that are pending may be safe.
            reason = NO_SAFE_START if self.trials else START_REFUSED
            self.standstill = "" if pending else reason
            return None
        step = self._first_step()
        if step is not None:
            return Proposal(step, EXPANSION)
        proposal = self.propose(self._safe)
        refused = any(proposal.parameters == parameters for parameters in self.refused)
        if proposal.origin == REPETITION and (refused or self._repeated >= REPEATED):
            self.standstill = "" if pending else self._in_the_way
            return None
        return proposal

    def without_point(self, rng: np.random.Generator) -> tuple[dict[str, Value], str]:
        """Return the parameter set that has kept its limits and has the best objective so far."""
        objective = self.study.objective

        def cost(trial: Trial) -> float:
            mean = trial.mean(objective.metric)
            return np.inf if mean is None else objective.sign * mean

        free = [trial for trial in self._kept if trial.parameters not in self.refused]
        return dict(min(free or self._kept, key=cost).parameters), REPETITION

    def _first_step(self) -> dict[str, Value] | None:
        """Return the start with one number changed that no trial has changed; None after all."""
        space, first = self.space, self._kept[0]
        start = space.to_cube(first.parameters)
        tried = space.cube_of(t.parameters for t in (*self.trials, *self.pending))
        travel = Reach.of(self.study, [first], self._how.travel, 1.0).travel
        for column, name in enumerate(space.names):
            if name not in space.numbers or (tried[:, column] != start[column]).any():
                continue
            inwards = 1.0 if start[column] < 0.5 else -1.0
            if self.study.parameters[name].is_integer:
                points = space.integer_neighbour_points(first.parameters)
                points = points[points[:, column] != start[column]]
            else:
                points = space.repair(start + inwards * FIRST_STEP * np.diag(travel)[[column]])
            if len(points):
                step = points[int((inwards * points[:, column]).argmax())]
                parameters = space.to_parameters(step)
                if not self.has_judged(parameters):
                    return parameters
        return None

    @property
    def _kept(self) -> list[Trial]:
        return kept_by(self.study, self.trials)

    @property
    def _repeated(self) -> int:
        """Number of the latest trials, in a row, that ran a known parameter set again."""
        latest = (*self.trials, *self.pending)[::-1]
        return sum(1 for _ in takewhile(lambda t: t.proposed_as == REPETITION, latest))

    def _safe(
        self, surrogates: PooledSurrogates, rng: np.random.Generator
    ) -> Iterator[tuple[Array, str]]:
        """Yield the best safe points within reach, with their origin."""
        self._in_the_way = ALL_TRIED
        trust, kept = trust_after(self.study, self.trials), self._kept
        search = AcquisitionSearch(surrogates, self.space, self._acquisition, rng)
        model = surrogates.objective
        if model is not None:
            points = self.space.cube_of(trial.parameters for trial in kept)
            lowest = model.predict_mean(points).min()
            search.incumbent = float(model.compression.apply(lowest))
        goal = search.maximize().position
        reach = Reach.of(self.study, kept, self._how.travel, trust)
        safe_set = SafeSet(surrogates, trust * self._how.risk)
        candidates = self._allowed(reach.candidates(goal, rng), reach.travel)
        safe = candidates[safe_set.contains(candidates)]
        if not len(safe):
            self._in_the_way = self._obstacle(safe_set, candidates)
            return
        improvement = self._acquisition(
            surrogates, search.incumbent, avoid=0.5, reinterpolate=True
        )(safe)
        improving = [(safe[k], ACQUISITION) for k in np.argsort(-improvement)[:TRIED_ANEW]]
        worth = safe[self._may_improve(surrogates, safe, search.incumbent)]
        uncertainty = safe_set.uncertainty(worth)
        growing = [(worth[k], EXPANSION) for k in np.argsort(-uncertainty)[:TRIED_ANEW]]
        first, second = (growing, improving) if self._grows else (improving, growing)
        yield from first
        yield from second

    def _allowed(self, x: Array, travel: Array) -> Array:
        """Return the points x (m, d) that are not close to one that somebody has refused.

        Else the next proposal would be nearly the same.
        """
        for refused in self.space.cube_of(self.refused):
            x = x[(np.abs(x - refused) > CLOSE * travel).any(axis=1)]
        return x

    def _may_improve(
        self, surrogates: PooledSurrogates, x: Array, incumbent: float | None
    ) -> NDArray[np.bool_]:
        """Return which (m,) of x (m, d) may be better than the best known one."""
        if surrogates.objective is None or incumbent is None:
            return np.ones(len(x), dtype=bool)
        mean, variance = surrogates.objective.predict(x)
        return mean - OPTIMISM * np.sqrt(variance) < incumbent

    @property
    def _grows(self) -> bool:
        """Whether the next trial grows the set: the one before did not."""
        latest = (*self.trials, *self.pending)[-1]
        return latest.proposed_as in (DEFAULT, START, ACQUISITION)

    def _obstacle(self, safe_set: SafeSet, candidates: Array) -> str:
        """Return which limit keeps all candidates (m, d) from being safe, and what would help."""
        if not len(candidates):
            return ALL_TRIED
        name, sure = safe_set.most_doubtful(candidates) if safe_set.limits else ("", 0.0)
        limit = f"the limit {name}" if name else "that no run fails"
        return (
            f"of no parameter set within reach it is {percent(CONFIDENCE)} sure that "
            f"{percent(1.0 - safe_set.risk)} of the runs keep {limit}, at most {percent(sure)}: a "
            "start farther within the limit, a wider limit, a larger safe_search.risk or narrower "
            "contexts would help"
        )
