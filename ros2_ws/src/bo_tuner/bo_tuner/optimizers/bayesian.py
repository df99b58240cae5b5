"""Bayesian optimization, Algorithm 1 of the paper."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from bo_tuner.acquisition.acquisition import (
    AcquisitionRule,
    WithPrior,
    best_at_data,
    constrained_improvement,
)
from bo_tuner.models.categories import Coding
from bo_tuner.models.constraints import BELIEVED_FEASIBLE
from bo_tuner.models.fantasies import fantasies
from bo_tuner.models.protocol import Model
from bo_tuner.models.surrogates import FitSurrogates, Surrogates
from bo_tuner.numerics.arrays import Array
from bo_tuner.numerics.local_search import ascend
from bo_tuner.numerics.particle_swarm import SwarmSettings, maximize
from bo_tuner.numerics.seeds import Stream, generator
from bo_tuner.optimizers.base import (
    ACQUISITION,
    RANDOM,
    REFINEMENT,
    SPACE_FILLING,
    DesignedOptimizer,
    Hopeless,
    Proposal,
)
from bo_tuner.optimizers.box import Box
from bo_tuner.optimizers.trust_region import MANY, trust_region
from bo_tuner.study.search_space import SearchSpace
from bo_tuner.study.study import Study
from bo_tuner.trials import Trial, Value, count_evaluations

NEGLIGIBLE = 1e-3
"""Largest acquisition, in standard deviations of the cost, that is not worth a trial.

The reinterpolation model has little variance between close points, so its expected improvement can
vanish everywhere although noise leaves the incumbent uncertain. The remaining trials then maximize
the improvement under the noisy model, which refines the estimates around the incumbent.
"""

FEWEST = 2
"""Trials that must be more before a model tells anything, with one or two parameters."""

STARTS = 8
"""Number of the most promising points that particles of the swarm start near."""

NEAR = (0.05,)
"""Standard deviations of their distances from these, along each edge of the cube."""

NEAR_IN_GAPS = (0.05, 1e-2, 1e-3, 1e-4)
"""The same where `leaves_gaps`."""

SPACE_FILLING_CANDIDATES = 512

BELIEF = 0.1
"""β of a prior, as a share of the trials."""

S = TypeVar("S", bound=Surrogates)

PointRule = Callable[[S, np.random.Generator], Iterator[tuple[Array, str]]]
"""Yields points (d,) to try, the most promising one first, each with the origin of its proposal."""


@dataclass(frozen=True, eq=False)
class Maximum:
    """Where an acquisition function is largest.

    Attributes
    ----------
    position : ndarray, shape (d,)
        A point of the search space.
    value
        The acquisition there, on the scale of its logarithms; -inf if every point is excluded.
    log_gain
        Logarithm of the expected gain there, in the unit of the cost; None if the acquisition is
        none of an expected improvement.
    """

    position: Array
    value: float
    log_gain: float | None

    def is_negligible(self, scale: float) -> bool:
        """Return whether a gain is expected, but less than is worth a trial.

        Parameters
        ----------
        scale
            Standard deviation of the cost.
        """
        return self.log_gain is not None and self.log_gain < np.log(NEGLIGIBLE * scale)


class AcquisitionSearch:
    """Maximization of the acquisition function by a particle swarm, and where it is narrow exactly.

    Parameters
    ----------
    surrogates
        Models of all trials.
    space
        The search space.
    rule
        Makes the acquisition function.
    rng
        Draws the starting points and the moves of the swarm.
    narrow
        Whether it is, see `leaves_gaps`.

    Attributes
    ----------
    feasible : ndarray of bool, shape (n,)
        Which of the n points in the objective's data are believed feasible; n = 0 without a model.
    incumbent : float or None
        Lowest posterior mean of the cost at the feasible points, on the scale of predictions; None
        if there are none.
    """

    def __init__(
        self,
        surrogates: Surrogates,
        space: SearchSpace,
        rule: AcquisitionRule,
        rng: np.random.Generator,
        *,
        narrow: bool = False,
    ) -> None:
        self._narrow = narrow
        self._surrogates = surrogates
        self._space = space
        self._rule = rule
        self._rng = rng
        self.feasible: NDArray[np.bool_] = np.zeros(0, dtype=bool)
        self.incumbent: float | None = None
        self._starts = np.empty((0, space.dimension))
        model = surrogates.objective
        if model is not None:
            self.feasible = _believed_feasible(surrogates, model)
            self.incumbent = best_at_data(model, self.feasible)
            # Some particles start near the points with the lowest cost, feasible ones first.
            cost = model.predict_mean(model.points)
            order = np.lexsort((cost, ~self.feasible))[:STARTS]
            near = np.array(NEAR_IN_GAPS if narrow else NEAR)[:, None, None]
            around = near * rng.normal(0.0, 1.0, (len(near), len(order), space.dimension))
            starts = np.clip(model.points[order] + around, 0.0, 1.0)
            self._starts = starts.reshape(-1, space.dimension)

    def maximize(
        self, *, avoid: float = 0.5, reinterpolate: bool = True, within: Box | None = None
    ) -> Maximum:
        """Maximize the acquisition function over the unit cube.

        Parameters
        ----------
        avoid
            Largest probability of a failure.
        reinterpolate
            Whether the improvement is under the reinterpolation model.
        within
            Part of the cube that is searched, all of it if None. An integer at its edge may be
            rounded to the value beyond.
        """
        acquisition = self._rule(
            self._surrogates, self.incumbent, avoid=avoid, reinterpolate=reinterpolate
        )
        starts = self._starts
        if within is not None:
            count = max(SwarmSettings.particles - len(starts), 0)
            drawn = within.latin_hypercube(count, self._rng)
            starts = np.concatenate([within.nearest(starts), drawn])

        def repair(positions: Array) -> Array:
            return self._space.repair(positions if within is None else within.nearest(positions))

        maximum = maximize(
            acquisition,
            self._space.dimension,
            self._rng,
            improved=acquisition.where_above,
            repair=repair,
            initial=starts,
        )
        position, value = maximum.position, maximum.value
        if self._narrow and np.isfinite(value):
            position, value = ascend(acquisition, position, repair)
        if not acquisition.expected or self.incumbent is None:
            return Maximum(position, value, None)
        gain = value
        if acquisition.prior is not None:
            gain -= float(acquisition.prior(position[None])[0])
        return Maximum(position, value, gain)


class BayesianOptimization(DesignedOptimizer, Generic[S]):
    """Optimizer that fits surrogates to all trials and maximizes an acquisition function.

    The surrogates know trials that are pending by `fantasies`.

    Parameters
    ----------
    study
        The study.
    models
        Fits the surrogates.
    acquisition
        Makes the acquisition function.
    """

    def __init__(
        self,
        study: Study,
        models: FitSurrogates[S],
        acquisition: AcquisitionRule = constrained_improvement,
    ) -> None:
        super().__init__(study)
        self._models = models
        self._rule = acquisition

    @property
    def _acquisition(self) -> AcquisitionRule:
        """Makes the acquisition function of the next trial, by what is believed beforehand, too.

        Of N trials, the n-th after the initial design believes it to the power of N / (10 n), as in
        the experiments of Hvarfner et al.
        """
        if not self.space.has_prior:
            return self._rule
        spent = self.study.budget.part_spent(self.number, count_evaluations(self.trials))
        n = max(self.number - self.study.budget.initial_trials + 1, 1)
        planned = self.number / spent if spent > 0.0 else float(self.study.budget.trials)
        return WithPrior(self._rule, self.space.log_prior, BELIEF * planned / n)

    def ask(self, pending: Sequence[Trial] = ()) -> Proposal | None:
        """Propose the parameter set of the next trial."""
        self.pending = tuple(pending)
        return self.initial() or self.propose(self._most_promising)

    def initial(self) -> Proposal | None:
        """Return a proposal of no model: of the initial design, or while hardly a trial has ended.

        A model of one or two results, and of what it believes of the others, asks for corners.
        """
        designed = super().initial()
        if designed is not None or not self.pending or self.suffice(len(self.trials)):
            return designed
        tried = [trial.parameters for trial in (*self.trials, *self.pending)]
        (point,) = self.space.latin_hypercube(1, self.rng(), tried)
        return Proposal(self.space.to_parameters(point), RANDOM)

    def suffice(self, known: int) -> bool:
        """Return whether so many trials tell a model something of each parameter."""
        return known > max(self.space.dimension, FEWEST)

    def propose(self, points: PointRule[S], protocol: tuple[int, int] | None = None) -> Proposal:
        """Propose the first of `points` that was not tried before, evaluated by `protocol`.

        The proposal is a point far from all tried ones (origin ``space-filling``) if there is none,
        or if the computation fails numerically; a failure is also reported in the warnings.
        """
        rng = self.rng()
        warnings: tuple[str, ...] = ()
        outliers: frozenset[int] = frozenset()
        warm = latest_hyperparameters(self.trials)
        try:
            surrogates = self._fitted(rng, warm)
            warnings, outliers = surrogates.warnings, surrogates.outliers
            warm |= surrogates.warm_starts
            for point, origin in points(surrogates, rng):
                parameters = self.space.to_parameters(point)
                if not self.has_judged(parameters):
                    hopeless = self.hopeless(surrogates, parameters)
                    return Proposal(
                        parameters, origin, warnings, warm, protocol, outliers, hopeless
                    )
        except (ArithmeticError, np.linalg.LinAlgError, ValueError) as error:
            cause = f"{type(error).__name__}: {error}"
            warnings += (f"the acquisition function could not be maximized: {cause}",)
        parameters, origin = self.without_point(rng)
        return Proposal(parameters, origin, warnings, warm, protocol, outliers)

    def without_point(self, rng: np.random.Generator) -> tuple[dict[str, Value], str]:
        """Return the parameter set where no point is proposed, with its origin."""
        tried = self.space.cube_of(t.parameters for t in (*self.trials, *self.pending))
        return self.space.to_parameters(space_filling(self.space, tried, rng)), SPACE_FILLING

    def _fitted(self, rng: np.random.Generator, start: Mapping[str, Sequence[float]]) -> S:
        """Fit the surrogates to what is known, and condition them on what is pending."""
        weights = self._weights()
        surrogates = self._models(self.study, self.trials, rng=rng, start=start, weights=weights)
        draws = generator(self.study.seed, Stream.FANTASIES, self.number)
        believed = fantasies(self.study, self.trials, self.pending, draws)
        if not believed:
            return surrogates
        return self._models(
            self.study,
            [*self.trials, *believed],
            rng=rng,
            start=surrogates.warm_starts,
            weights=weights,
            keep=True,
        )

    def _weights(self) -> Array | None:
        """Draw the weights (k,) of k objectives, uniformly; None for a single one."""
        count = len(self.study.objectives)
        if count == 1:
            return None
        rng = generator(self.study.seed, Stream.WEIGHTS, self.number)
        return rng.dirichlet(np.ones(count))

    def _most_promising(
        self, surrogates: S, rng: np.random.Generator
    ) -> Iterator[tuple[Array, str]]:
        """Yield the maximum of the acquisition function, if there is one, with its origin."""
        search = AcquisitionSearch(
            surrogates, self.space, self._acquisition, rng, narrow=leaves_gaps(self.study)
        )
        within = self.within(surrogates, found=search.incumbent is not None)
        avoid = self.avoid
        maximum = search.maximize(avoid=avoid, within=within)
        if not np.isfinite(maximum.value):
            # Every point is near a failure or an outlier: rank them by Eq. 5 without the cutoff.
            avoid = 1.0
            maximum = search.maximize(avoid=avoid, within=within)
        origin = ACQUISITION
        model = surrogates.objective
        if model is not None and maximum.is_negligible(model.scale):
            maximum = search.maximize(avoid=avoid, reinterpolate=False, within=within)
            origin = REFINEMENT
        if np.isfinite(maximum.value):
            yield maximum.position, origin

    @property
    def avoid(self) -> float:
        """Largest probability of a failure or an outlier of a proposal, as long as others exist."""
        return 0.5

    def hopeless(self, surrogates: S, parameters: Mapping[str, Value]) -> Hopeless:
        """Return beyond what a run of a parameter set is hopeless; by default nothing is."""
        return Hopeless()

    def within(self, surrogates: S, *, found: bool) -> Box | None:
        """Return where a point is searched, None for the whole cube.

        Many parameters are searched in a trust region; of few it is the whole cube once a feasible
        parameter set is `found`.
        """
        if self.space.dimension <= MANY:
            return None if found else self.around(surrogates)
        model = surrogates.objective
        return trust_region(self.study, self.trials, None if model is None else model.length_scales)

    def around(self, surrogates: S) -> Box | None:
        """Return where a first feasible parameter set is searched, None for the whole cube."""
        return None


def leaves_gaps(study: Study) -> bool:
    """Return whether what is left to gain is a narrow gap between the incumbent and a limit.

    Where a run tells on which side of a limit it is, a swarm finds the gap, but does not fill it.
    With noise nobody can go that close, and without limits a maximum to many digits gained nothing.
    """
    return study.a_run_tells_all and bool(study.constraints)


def lowest_believed(surrogates: Surrogates) -> float | None:
    """Return the lowest posterior mean of what is believed feasible, as `best_at_data`."""
    model = surrogates.objective
    return None if model is None else best_at_data(model, _believed_feasible(surrogates, model))


def _believed_feasible(surrogates: Surrogates, model: Model) -> NDArray[np.bool_]:
    """Return which of the n points of a model's data are believed feasible, (n,)."""
    believed: NDArray[np.bool_] = surrogates.log_feasibility(model.points) >= np.log(
        BELIEVED_FEASIBLE
    )
    return believed


def latest_hyperparameters(trials: Sequence[Trial]) -> dict[str, tuple[float, ...]]:
    """Return the hyperparameters of the latest trial that has any, where the next fit starts."""
    latest = (t.hyperparameters for t in reversed(trials) if t.hyperparameters)
    return dict(next(latest, {}))


def space_filling(space: SearchSpace, tried: Array, rng: np.random.Generator) -> Array:
    """Return the point (d,), among random ones, with the largest distance to the `tried` (n, d)."""
    candidates = space.latin_hypercube(SPACE_FILLING_CANDIDATES, rng)
    farthest: Array = candidates[int(distances(space, tried, candidates).argmax())]
    return farthest


def distances(space: SearchSpace, tried: Array, points: Array) -> Array:
    """Return the distance (m,) of points (m, d) from the nearest of `tried` (n, d); or infinite."""
    if not len(tried):
        return np.full(len(points), np.inf)
    coding = Coding(space.levels)
    apart = coding.encode(points)[:, None, :] - coding.encode(tried)[None, :, :]
    nearest: Array = np.sqrt((apart**2).sum(axis=2).min(axis=1))
    return nearest
