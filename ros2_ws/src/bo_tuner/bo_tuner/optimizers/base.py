"""Interface of the optimizers of stage one (Sec. 4.1), and the initial design they share."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from bo_tuner.numerics.seeds import Stream, generator
from bo_tuner.study.study import Study
from bo_tuner.trials import Trial, Value

DEFAULT, START = "default", "start"
INITIAL, ACQUISITION, REFINEMENT = "initial", "acquisition", "refinement"
RANDOM, SPACE_FILLING = "random", "space-filling"


@dataclass(frozen=True)
class Proposal:
    """A parameter set to try.

    Attributes
    ----------
    parameters
        Every parameter of the study.
    origin
        How it was proposed: ``default``, ``start``, ``initial``, ``acquisition``, ``refinement``,
        ``random`` or ``space-filling``.
    warnings
        Numerical problems while it was proposed, one line each.
    hyperparameters
        As in `Trial`.
    protocol
        Evaluations of the trial: in drawn contexts, and those in the worst one. By default as the
        study and the algorithm have it.
    outliers
        Numbers of the trials that its models left out.
    """

    parameters: dict[str, Value]
    origin: str
    warnings: tuple[str, ...] = ()
    hyperparameters: dict[str, tuple[float, ...]] = field(default_factory=dict)
    protocol: tuple[int, int] | None = None
    outliers: frozenset[int] = frozenset()


class Optimizer(Protocol):
    """Optimizer with an ask-and-tell interface.

    A proposal depends only on the study and the trials passed to `tell`, so a run can be resumed.
    """

    def ask(self) -> Proposal:
        """Propose the parameter set of the next trial."""

    def tell(self, trial: Trial) -> None:
        """Add a finished trial, complete or failed."""


class DesignedOptimizer:
    """Base of the optimizers that start with what the study names, and a Latin hypercube.

    The hypercube has as many points as are left of the initial design.

    Parameters
    ----------
    study
        The study.

    Attributes
    ----------
    study, space
        The study and its search space.
    trials
        All trials passed to `tell`.
    """

    def __init__(self, study: Study) -> None:
        self.study = study
        self.space = study.search_space()
        self.trials: list[Trial] = []
        self._keys: set[tuple[Value, ...]] = set()
        self._judged: set[tuple[Value, ...]] = set()
        self._starts = study.starting_sets()
        drawn = study.budget.initial_trials - len(self._starts)
        self._design = np.empty((0, self.space.dimension))
        if drawn > 0:
            rng = generator(study.seed, Stream.INITIAL_DESIGN)
            self._design = self.space.latin_hypercube(drawn, rng, self._starts)

    def tell(self, trial: Trial) -> None:
        """Add a finished trial, complete or failed."""
        self.trials.append(trial)
        key = self.space.key(trial.parameters)
        self._keys.add(key)
        if not trial.disturbed:
            self._judged.add(key)

    def has_tried(self, parameters: Mapping[str, Value]) -> bool:
        """Return whether a trial had the same parameter set."""
        return self.space.key(parameters) in self._keys

    def has_judged(self, parameters: Mapping[str, Value]) -> bool:
        """Return whether a trial had the same parameter set, and nobody disturbed it.

        Of one that was disturbed the models know nothing, so it may be what they propose again.
        """
        return self.space.key(parameters) in self._judged

    def initial(self) -> Proposal | None:
        """Return the initial design's proposal for the next trial, or None after the last."""
        for parameters in self._starts:
            if not self.has_tried(parameters):
                is_default = parameters == self.space.defaults
                return Proposal(parameters, DEFAULT if is_default else START)
        # Trials of an earlier run take the place of as many points.
        number = len(self.trials) - len(self._starts)
        if number >= len(self._design):
            return None
        return Proposal(self.space.to_parameters(self._design[number]), INITIAL)

    def rng(self) -> np.random.Generator:
        """Return the random generator of the next proposal."""
        return generator(self.study.seed, Stream.ACQUISITION, len(self.trials))
