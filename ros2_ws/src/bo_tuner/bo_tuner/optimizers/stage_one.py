"""Stage one: which parameter set to try next (Sec. 4.1), by ask and tell."""

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from bo_tuner.acquisition.acquisition import LogAcquisition, best_at_data
from bo_tuner.models.hyperpriors import Hyperparameters
from bo_tuner.models.surrogates import DEFAULT_MODELS, ModelOptions, Surrogates
from bo_tuner.numerics.arrays import Array
from bo_tuner.numerics.particle_swarm import SwarmResult, maximise
from bo_tuner.numerics.seeds import Stream, generator
from bo_tuner.study.search_space import SearchSpace
from bo_tuner.study.study import Study
from bo_tuner.trials import Trial, Value

INITIAL, ACQUISITION, REFINEMENT = "initial", "acquisition", "refinement"
RANDOM, SPACE_FILLING = "random", "space-filling"

BELIEVED_FEASIBLE = np.log(0.5)
"""Log probability of feasibility from which a parameter set counts as feasible."""

NEGLIGIBLE = 1e-3
"""Acquisition below this, relative to the spread of the cost, is no gain worth a trial.

The interpolating model takes what lies between noisy data for known, and its improvement can vanish
everywhere although the incumbent is known only to the noise. The trials left then refine what is
known around it.
"""

STARTS = 8
"""So many particles of the swarm start around the most promising points."""

SPACE_FILLING_CANDIDATES = 512


@dataclass(frozen=True)
class Proposal:
    """A parameter set to try.

    Attributes
    ----------
    parameters
        Every parameter of the study.
    origin
        What proposed it: ``initial``, ``acquisition``, ``refinement``, ``random`` or
        ``space-filling``.
    warnings
        Numerical trouble on the way.
    hyperparameters
        As in `Trial`.
    """

    parameters: dict[str, Value]
    origin: str
    warnings: tuple[str, ...] = ()
    hyperparameters: dict[str, tuple[float, ...]] = field(default_factory=dict)


class StageOne(Protocol):
    """Proposes parameter sets from the trials that it is told.

    What it proposes depends on the study and these trials alone, so that a run can be resumed.
    """

    def ask(self) -> Proposal:
        """Propose the next trial's parameter set."""

    def tell(self, trial: Trial) -> None:
        """Take note of a finished trial, complete or failed."""


class _Designed:
    """An initial Latin hypercube and the memory of all trials."""

    def __init__(self, study: Study) -> None:
        self.study = study
        self.space = study.search_space()
        self.trials: list[Trial] = []
        self._design = self.space.latin_hypercube(
            study.budget.initial_trials, generator(study.seed, Stream.INITIAL_DESIGN)
        )

    def tell(self, trial: Trial) -> None:
        """Take note of a finished trial, complete or failed."""
        self.trials.append(trial)

    def initial(self) -> Proposal | None:
        """Return the design's point for the next trial, or None after the last."""
        number = len(self.trials)
        if number >= len(self._design):
            return None
        return Proposal(self.space.to_parameters(self._design[number]), INITIAL)

    def rng(self) -> np.random.Generator:
        """Random generator of the next trial."""
        return generator(self.study.seed, Stream.ACQUISITION, len(self.trials))


class RandomSearch(_Designed):
    """Algorithm II: random parameter sets, with the same initial design."""

    def ask(self) -> Proposal:
        """Propose the next trial's parameter set."""
        proposal = self.initial()
        if proposal is None:
            cube = self.space.latin_hypercube(1, self.rng())[0]
            proposal = Proposal(self.space.to_parameters(cube), RANDOM)
        return proposal


class BayesianOptimization(_Designed):
    """Algorithm 1 of the paper: surrogates of all trials, acquisition of Eq. 5, particle swarm.

    Parameters
    ----------
    study
        The study.
    options
        Which models stand for the responses.
    """

    def __init__(self, study: Study, options: ModelOptions = DEFAULT_MODELS) -> None:
        super().__init__(study)
        self._options = options

    def ask(self) -> Proposal:
        """Propose the next trial's parameter set.

        A parameter set that was tried is never proposed again while others are left. Numerical
        trouble falls back on a point far from all that was tried, with a warning.
        """
        proposal = self.initial()
        if proposal is not None:
            return proposal
        rng = self.rng()
        warnings: tuple[str, ...] = ()
        latest = next((t.hyperparameters for t in reversed(self.trials) if t.hyperparameters), {})
        warm = dict(latest)
        cube = None
        try:
            surrogates = Surrogates.fit(
                self.study,
                self.trials,
                rng=rng,
                start={n: Hyperparameters.from_log(np.array(p)) for n, p in latest.items()},
                options=self._options,
            )
            warnings = surrogates.warnings
            warm |= {
                name: tuple(h.to_log().tolist()) for name, h in surrogates.hyperparameters.items()
            }
            cube, origin = self._search(surrogates, rng)
        except (ArithmeticError, np.linalg.LinAlgError, ValueError) as error:
            warnings += (f"no acquisition: {type(error).__name__}: {error}",)
        if cube is not None:
            parameters = self.space.to_parameters(cube)
            if self._key(parameters) not in {self._key(t.parameters) for t in self.trials}:
                return Proposal(parameters, origin, warnings, warm)
        cube = space_filling(self.space, self._tried(), rng)
        return Proposal(self.space.to_parameters(cube), SPACE_FILLING, warnings, warm)

    def _search(self, surrogates: Surrogates, rng: np.random.Generator) -> tuple[Array | None, str]:
        model = surrogates.objective
        best = None
        starts = np.empty((0, self.space.dimension))
        if model is not None:
            points = model.data.x
            log_feasible = surrogates.log_feasibility(points)
            best = best_at_data(model, log_feasible >= BELIEVED_FEASIBLE)
            # The swarm also looks around the most promising points so far.
            cost, _ = model.predict(points)
            order = np.lexsort((cost, log_feasible < BELIEVED_FEASIBLE))[:STARTS]
            starts = points[order] + rng.normal(0.0, 0.05, (len(order), self.space.dimension))
        # Without a single outlier or failure there is nothing to avoid.
        classifiers = tuple(c for c in surrogates.classifiers if c.labels.any())
        acquisition = LogAcquisition(model, best, surrogates.constraints, classifiers)
        found = self._maximise(acquisition, starts, rng)
        if not np.isfinite(found.value):
            # Nothing is left that is not near a crash; Eq. 5 as it stands says where least.
            acquisition = dataclasses.replace(acquisition, avoid=1.0)
            found = self._maximise(acquisition, starts, rng)
        origin = ACQUISITION
        if model is not None and best is not None:
            negligible = np.log(NEGLIGIBLE * model.standardisation.scale)
            if found.value < negligible:
                noisy = dataclasses.replace(acquisition, reinterpolate=False)
                found = self._maximise(noisy, starts, rng)
                origin = REFINEMENT
        return (found.position if np.isfinite(found.value) else None), origin

    def _maximise(
        self, acquisition: LogAcquisition, starts: Array, rng: np.random.Generator
    ) -> SwarmResult:
        return maximise(
            acquisition,
            self.space.dimension,
            rng,
            repair=self.space.repair,
            initial=np.clip(starts, 0.0, 1.0),
        )

    def _tried(self) -> Array:
        names = self.space.names
        rows = [self.space.to_cube({n: t.parameters[n] for n in names}) for t in self.trials]
        return np.array(rows).reshape(-1, self.space.dimension)

    def _key(self, parameters: Mapping[str, Value]) -> tuple[Value, ...]:
        return self.space.key({name: parameters[name] for name in self.space.names})


def space_filling(space: SearchSpace, tried: Array, rng: np.random.Generator) -> Array:
    """Point (d,) of the cube that is farthest from all points `tried` (n, d), among random ones."""
    candidates = space.latin_hypercube(SPACE_FILLING_CANDIDATES, rng)
    farthest: Array = candidates[0]
    if len(tried) > 0:
        squared = ((candidates[:, None, :] - tried[None, :, :]) ** 2).sum(axis=2)
        farthest = candidates[int(squared.min(axis=1).argmax())]
    return farthest
