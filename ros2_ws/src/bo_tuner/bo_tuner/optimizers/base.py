"""What the loop asks of an optimizer: which parameter set to try next (Sec. 4.1)."""

from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from bo_tuner.numerics.seeds import Stream, generator
from bo_tuner.study.study import Study
from bo_tuner.trials import Trial, Value

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


class Optimizer(Protocol):
    """Proposes parameter sets from the trials that it is told, by ask and tell.

    What it proposes depends on the study and these trials alone, so that a run can be resumed.
    """

    def ask(self) -> Proposal:
        """Propose the next trial's parameter set."""

    def tell(self, trial: Trial) -> None:
        """Take note of a finished trial, complete or failed."""


class DesignedOptimizer:
    """What optimizers with an initial Latin hypercube share: the design and the trials so far.

    Parameters
    ----------
    study
        The study.
    """

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
