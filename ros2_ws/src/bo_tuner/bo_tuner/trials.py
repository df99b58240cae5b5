"""The record of a run: evaluations, and the trials that they make up."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum

Value = int | float


class Stage(StrEnum):
    """What an evaluation was run for."""

    NOMINAL = "nominal"
    DRAWN = "drawn"
    SEARCH = "search"
    CHECK_DRAWN = "check-drawn"
    CHECK_WORST = "check-worst"
    VALIDATION = "validation"


TUNING = (Stage.NOMINAL, Stage.DRAWN, Stage.SEARCH)
"""Stages of a trial; what follows are checks of its candidates and the validation."""

ESTIMATING = (Stage.NOMINAL, Stage.DRAWN, Stage.CHECK_DRAWN)
"""Stages whose contexts follow the distribution that the objective is an expectation over."""


class EvaluationState(StrEnum):
    """How an evaluation ended: whole, failed in itself, or lost with a node."""

    COMPLETE = "complete"
    FAILED = "failed"
    LOST = "lost"


class TrialState(StrEnum):
    """How a trial ended; only a complete one has values, a failed one is infeasible."""

    COMPLETE = "complete"
    FAILED = "failed"


DISTURBED = "disturbed"
"""Key of an outcome's details: who ran the evaluation was not alone with its nodes."""


@dataclass(frozen=True)
class Outcome:
    """What a backend reports of one evaluation.

    Attributes
    ----------
    state
        An evaluation whose metrics are not all finite is not complete.
    metrics
        The study's metrics by name, each in its unit; empty unless complete.
    reason
        Why the evaluation is not complete.
    details
        All else that the nodes said of the evaluation, as text.
    """

    state: EvaluationState
    metrics: Mapping[str, float] = field(default_factory=dict)
    reason: str = ""
    details: Mapping[str, str] = field(default_factory=dict)

    @property
    def spoilt(self) -> bool:
        """Whether it tells nothing of its parameters: its nodes were lost, or others disturbed."""
        return self.state is EvaluationState.LOST or DISTURBED in self.details


@dataclass(frozen=True)
class Evaluation:
    """One closed-loop run of a trial.

    Attributes
    ----------
    trial, index
        Number of the trial, and of the evaluation within it, both from 0.
    stage
        What the evaluation was run for.
    parameters
        Value of every parameter of the study.
    context
        Value of each context variable.
    seed
        Seed of the noise.
    outcome
        What came of it; of an evaluation that is only planned, that it was not run.
    seconds
        How long it took [s]; no part of what makes two evaluations equal.
    recorded
        Whether the outcome was on record already; no part of equality either.
    """

    trial: int
    index: int
    stage: Stage
    parameters: Mapping[str, Value]
    context: Mapping[str, float]
    seed: int
    outcome: Outcome = Outcome(EvaluationState.FAILED, reason="not run")
    seconds: float = field(default=0.0, compare=False)
    recorded: bool = field(default=False, compare=False)


@dataclass(frozen=True)
class WorstCase:
    """Estimate of the worst metric over all contexts.

    Attributes
    ----------
    value
        The estimate, in the metric's unit.
    context
        Where it was found.
    observed
        The largest single observation.
    noise
        Standard deviation of a single observation in that context; 0 if the estimate counts it
        in already.
    """

    value: float
    context: Mapping[str, float]
    observed: float
    noise: float = 0.0


@dataclass(frozen=True)
class Trial:
    """One parameter set and all that was found out about it.

    Attributes
    ----------
    number
        From 0, in the order of the run.
    parameters
        Every parameter of the study, tied and fixed ones included.
    origin
        What proposed it, such as ``initial`` or ``acquisition``.
    state, reason
        Outcome, and why the trial failed.
    evaluations
        All its evaluations.
    worst_case
        Worst case of the constrained metric, if the study has such a constraint.
    warnings
        Numerical trouble on the way to the proposal.
    hyperparameters
        Logarithms of the hyperparameters of the surrogates behind the proposal, by name, from
        which the next ones start.
    seconds
        How long it took to propose it [s]; no part of what makes two trials equal.
    """

    number: int
    parameters: Mapping[str, Value]
    origin: str
    state: TrialState
    reason: str = ""
    evaluations: tuple[Evaluation, ...] = ()
    worst_case: WorstCase | None = None
    warnings: tuple[str, ...] = ()
    hyperparameters: Mapping[str, tuple[float, ...]] = field(default_factory=dict)
    seconds: float = field(default=0.0, compare=False)

    def observations(self, metric: str) -> list[float]:
        """Values of `metric` in the evaluations that estimate its distribution."""
        return [
            evaluation.outcome.metrics[metric]
            for evaluation in self.evaluations
            if evaluation.stage in ESTIMATING
            and evaluation.outcome.state is EvaluationState.COMPLETE
        ]
