"""Interface of the optimizers of stage one (Sec. 4.1), and the initial design they share."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from bo_tuner.numerics.seeds import Stream, generator
from bo_tuner.study.study import Study
from bo_tuner.trials import ESTIMATING, Stage, Trial, Value

DEFAULT, START = "default", "start"
INITIAL, ACQUISITION, REFINEMENT = "initial", "acquisition", "refinement"
RANDOM, SPACE_FILLING = "random", "space-filling"
EXPANSION, REPETITION = "expansion", "repetition"


@dataclass(frozen=True)
class Hopeless:
    """Beyond what a run shows that its parameter set cannot be the answer.

    Attributes
    ----------
    anywhere
        By metric the value beyond which it does, in its unit, whatever the context.
    drawn
        The same for a context that was drawn: of what is over the distribution of the contexts.
    """

    anywhere: Mapping[str, float] = field(default_factory=dict)
    drawn: Mapping[str, float] = field(default_factory=dict)

    def beyond(self, stage: Stage) -> dict[str, float]:
        """Return by metric the value beyond which a run of a stage is hopeless."""
        bounds = dict(self.anywhere)
        for name, most in self.drawn.items() if stage in ESTIMATING else ():
            bounds[name] = min(most, bounds.get(name, most))
        return bounds


@dataclass(frozen=True)
class Proposal:
    """A parameter set to try.

    Attributes
    ----------
    parameters
        Every parameter of the study.
    origin
        How it was proposed: ``default``, ``start``, ``initial``, ``acquisition``, ``refinement``,
        ``random``, ``space-filling``, ``expansion`` or ``repetition``.
    warnings
        Numerical problems while it was proposed, one line each.
    hyperparameters
        Logarithms of the hyperparameters behind the proposal, by model name.
    protocol
        Evaluations of the trial: in drawn contexts, and those in the worst one. By default as the
        study and the algorithm have it.
    outliers
        Numbers of the trials that its models left out.
    hopeless
        Beyond what a run shows that the parameter set cannot be the answer.
    """

    parameters: dict[str, Value]
    origin: str
    warnings: tuple[str, ...] = ()
    hyperparameters: dict[str, tuple[float, ...]] = field(default_factory=dict)
    protocol: tuple[int, int] | None = None
    outliers: frozenset[int] = frozenset()
    hopeless: Hopeless = Hopeless()


class Optimizer(Protocol):
    """Optimizer with an ask-and-tell interface.

    A proposal depends only on the study, the trials passed to `tell` and those that are pending, so
    a run can be resumed.
    """

    @property
    def standstill(self) -> str:
        """Why it cannot go on, and what would help, in one line; empty while it can."""

    def ask(self, pending: Sequence[Trial] = ()) -> Proposal | None:
        """Propose the parameter set of the next trial.

        Parameters
        ----------
        pending
            Trials that were proposed later and have no results yet, in their order. Their
            evaluations are planned ones, in the contexts that they begin in.

        Returns
        -------
        Proposal or None
            None while something is pending: not before more is told; else: for the reason of
            `standstill`.
        """

    def tell(self, trial: Trial) -> None:
        """Add a finished trial, complete or failed."""

    def refuse(self, parameters: Mapping[str, Value]) -> None:
        """Never propose a parameter set again: somebody does not allow it."""


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
    pending
        As passed to `ask`.
    refused
        Parameter sets that somebody does not allow.
    standstill
        See `Optimizer`; most can always go on.
    """

    standstill = ""

    def __init__(self, study: Study) -> None:
        self.study = study
        self.space = study.search_space()
        self.trials: list[Trial] = []
        self.pending: tuple[Trial, ...] = ()
        self.refused: list[dict[str, Value]] = []
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
        if trial.was_withdrawn:
            # As if nobody had tried it.
            return
        key = self.space.key(trial.parameters)
        self._keys.add(key)
        if not trial.disturbed:
            self._judged.add(key)

    def refuse(self, parameters: Mapping[str, Value]) -> None:
        """Never propose a parameter set again: somebody does not allow it."""
        self.refused.append(dict(parameters))
        self._keys.add(self.space.key(parameters))
        self._judged.add(self.space.key(parameters))

    @property
    def number(self) -> int:
        """Number of the next trial."""
        return len(self.trials) + len(self.pending)

    def has_tried(self, parameters: Mapping[str, Value]) -> bool:
        """Return whether a trial had the same parameter set, or one that is pending has it."""
        return self.space.key(parameters) in self._keys or self._awaits(parameters)

    def has_judged(self, parameters: Mapping[str, Value]) -> bool:
        """Return whether an undisturbed or a pending trial has the same parameter set.

        The models know nothing of a disturbed trial, so they may propose it again.
        """
        return self.space.key(parameters) in self._judged or self._awaits(parameters)

    def _awaits(self, parameters: Mapping[str, Value]) -> bool:
        key = self.space.key(parameters)
        return any(self.space.key(trial.parameters) == key for trial in self.pending)

    def start(self) -> Proposal | None:
        """Return the first parameter set to start from that was not tried, or None after all."""
        for parameters in self._starts:
            if not self.has_tried(parameters):
                is_default = parameters == self.space.defaults
                return Proposal(parameters, DEFAULT if is_default else START)
        return None

    def initial(self) -> Proposal | None:
        """Return the initial design's proposal for the next trial, or None after the last."""
        start = self.start()
        if start is not None:
            return start
        # Trials of an earlier run take the place of as many points.
        number = self.number - len(self._starts)
        if number >= len(self._design):
            return None
        return Proposal(self.space.to_parameters(self._design[number]), INITIAL)

    def rng(self) -> np.random.Generator:
        """Return the random generator of the next proposal."""
        return generator(self.study.seed, Stream.ACQUISITION, self.number)
