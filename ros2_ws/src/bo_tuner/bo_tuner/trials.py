"""Evaluations and trials: the record of a run."""

from collections.abc import Container, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import Annotated, Any

from bo_tuner.codec.rules import Within
from bo_tuner.processor_load import Load
from bo_tuner.run_notes import Notes, Unusable

Value = bool | int | float | str
"""What a parameter of a study can be; a choice is text."""

Context = Mapping[str, Value]
"""Values of context variables by name; that of one with a double is a float."""

ParameterSet = tuple[tuple[str, Value], ...]
"""A parameter set as a hashable key: its parameters and their values, by name."""


class Stage(StrEnum):
    """Purpose of an evaluation."""

    NOMINAL = "nominal"
    DRAWN = "drawn"
    SEARCH = "search"
    CHECK_DRAWN = "check-drawn"
    CHECK_WORST = "check-worst"
    VALIDATION = "validation"


TUNING = (Stage.NOMINAL, Stage.DRAWN, Stage.SEARCH)
"""Stages of a trial; the others are those of the checks of candidates and of the validation."""

DEFAULT, TUNED = "default", "tuned"
"""The parameter sets that are compared."""

VALIDATED = (DEFAULT, TUNED)
"""What the number of a trial stands for in the validation."""

CHECKS = (Stage.CHECK_DRAWN, Stage.CHECK_WORST)
"""Stages in which a trial is evaluated again as a candidate."""

SEEKING_WORST = (Stage.SEARCH, Stage.CHECK_WORST)
"""Stages in what is taken for the worst context."""

ESTIMATING = (Stage.NOMINAL, Stage.DRAWN, Stage.CHECK_DRAWN)
"""Stages whose contexts follow the distribution that the objective is an expectation over."""


class EvaluationState(StrEnum):
    """How an evaluation ended: complete, failed, or lost because a node stopped.

    One that was cut short was ended on purpose, as its outcome was decided; see `Notes.at_least`.
    """

    COMPLETE = "complete"
    FAILED = "failed"
    LOST = "lost"
    CUT_SHORT = "cut short"


class TrialState(StrEnum):
    """How a trial ended; a failed trial has no values and counts as infeasible.

    One that ended with an evaluation that was cut short has no values of its own, either.
    """

    COMPLETE = "complete"
    FAILED = "failed"
    CUT_SHORT = "cut short"


def parameter_set(parameters: Mapping[str, Value]) -> ParameterSet:
    """Return the key that evaluations and trials of equal parameters share.

    `SearchSpace.key` is coarser: it is of the tuned parameters only, rounded to their resolution.
    """
    return tuple(sorted(parameters.items()))


NO_NOTES = Notes()


@dataclass(frozen=True)
class Outcome:
    """Result of one evaluation, as a backend reports it.

    Attributes
    ----------
    state
        How the evaluation ended; complete only if all metrics are finite.
    metrics
        The study's metrics by name, each in its unit; empty unless complete.
    reason
        Why the evaluation is not complete.
    details
        Further values that the nodes reported, as text.
    load
        How busy the computer was; None if nobody has looked. Ignored when outcomes are compared.
    notes
        What the tuner has noted of the run.
    """

    state: EvaluationState
    metrics: Mapping[str, float] = field(default_factory=dict)
    reason: str = ""
    details: Mapping[str, str] = field(default_factory=dict)
    load: Load | None = field(default=None, compare=False)
    notes: Notes = NO_NOTES

    @classmethod
    def cut_short(
        cls,
        seconds: float,
        at_least: Mapping[str, float],
        decided: str,
        details: Mapping[str, str] | None = None,
    ) -> "Outcome":
        """Return the outcome of a run that was ended since its outcome was decided.

        Parameters
        ----------
        seconds
            Time of the run [s] at which it was ended.
        at_least
            By metrics that only grow during a run the value by then, each in its unit.
        decided
            By what the outcome was decided, in words.
        details
            Further values that the nodes reported, as text.
        """
        seconds = round(seconds, 3)
        return cls(
            EvaluationState.CUT_SHORT,
            reason=f"cut short after {seconds:.3g} s: {decided}",
            details=details or {},
            notes=Notes(cut_after=seconds, at_least=at_least),
        )

    def noted(self, **notes: Any) -> "Outcome":
        """Return it with other `notes`, by the names of their fields."""
        return replace(self, notes=replace(self.notes, **notes))

    @property
    def complete(self) -> bool:
        """Whether it has all metrics of the study."""
        return self.state is EvaluationState.COMPLETE

    @property
    def was_cut_short(self) -> bool:
        """Whether it was ended on purpose: it has no metrics, and has not failed."""
        return self.state is EvaluationState.CUT_SHORT

    def died_of_parameters(self, node: str) -> "Outcome":
        """Return a loss, in which a node has died again with the same parameters, as a failure."""
        reason = (
            f"{self.reason}; it died twice with these parameters, which counts as their failure "
            f"(see nodes.{node}.death, and abort_when to end a run before)"
        )
        return replace(self, state=EvaluationState.FAILED, reason=reason)

    def with_starts(self, count: int, seconds: float) -> "Outcome":
        """Return it with further starts of nodes."""
        if not count:
            return self
        seconds = round(self.notes.start_seconds + seconds, 3)
        return self.noted(starts=self.notes.starts + count, start_seconds=seconds)

    @property
    def unusable(self) -> bool:
        """Whether it says nothing about its parameters."""
        return self.state is EvaluationState.LOST or self.notes.unusable is not None

    @property
    def ending(self) -> str:
        """How it ended, in a word: its state, or that it is `Unusable`."""
        return str(self.notes.unusable or self.state)


@dataclass(frozen=True)
class Evaluation:
    """One closed-loop run of a trial.

    Attributes
    ----------
    trial, index
        Number of the trial, and of the evaluation within it, both from 0.
    stage
        Purpose of the evaluation.
    parameters
        Value of every parameter of the study.
    context
        Value of each context variable.
    seed
        Seed of the noise.
    outcome
        Its result; that of a planned evaluation is a failure with the reason ``not run``.
    seconds
        Wall time [s]; ignored when evaluations are compared.
    recorded
        Whether the outcome was read from the journal; ignored when evaluations are compared.
    beyond
        By metrics that only grow during a run the value beyond which its outcome is decided, so
        that it may be cut short; ignored when evaluations are compared.
    """

    trial: int
    index: int
    stage: Stage
    parameters: Mapping[str, Value]
    context: Context
    seed: int
    outcome: Outcome = Outcome(EvaluationState.FAILED, reason="not run")
    seconds: float = field(default=0.0, compare=False)
    recorded: bool = field(default=False, compare=False)
    beyond: Mapping[str, float] = field(default_factory=dict, compare=False)

    @property
    def parameter_set(self) -> ParameterSet:
        """The parameters as a hashable key, which evaluations of equal ones share."""
        return parameter_set(self.parameters)

    @property
    def whose(self) -> int | str:
        """Number of the trial; in the validation the member of `VALIDATED` that it stands for."""
        sides = dict(enumerate(VALIDATED)) if self.stage is Stage.VALIDATION else {}
        return sides.get(self.trial, self.trial)

    @property
    def place(self) -> str:
        """Which one it is, in words, such as ``trial 3, evaluation 0``; see `whose`."""
        whose = self.whose
        side = whose if isinstance(whose, str) else f"trial {whose}"
        return f"{side}, test run {self.index}"


@dataclass(frozen=True)
class WorstCase:
    """Estimate of the worst metric over all contexts, on the side of a constraint's limit.

    Attributes
    ----------
    value
        The estimate, in the metric's unit.
    context
        Context of the estimate.
    observed
        Worst single observation, in the metric's unit.
    noise
        Standard deviation of a single observation in that context, in the metric's unit; 0 if the
        estimate already includes the noise.
    """

    value: float
    context: Context
    observed: float
    noise: Annotated[float, Within(least=0.0)] = 0.0


@dataclass(frozen=True)
class Trial:
    """One parameter set, its evaluations and the estimates from them.

    Attributes
    ----------
    number
        From 0, in the order of the run.
    parameters
        Every parameter of the study, tied and fixed ones included.
    origin
        How it was proposed, such as ``initial`` or ``acquisition``.
    state, reason
        How the trial ended, and why if it failed.
    evaluations
        All its evaluations, those of a check included.
    worst_cases
        Estimate for each worst-case constraint, by its name; empty unless the trial is complete.
    warnings
        Numerical problems while the parameter set was proposed, one line each.
    hyperparameters
        Logarithms of the hyperparameters of the surrogates behind the proposal, by model name;
        the next fit starts from them.
    seconds
        Wall time of the proposal [s]; ignored when trials are compared.
    """

    number: int
    parameters: Mapping[str, Value]
    origin: str
    state: TrialState
    reason: str = ""
    evaluations: tuple[Evaluation, ...] = ()
    worst_cases: Mapping[str, WorstCase] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()
    hyperparameters: Mapping[str, tuple[float, ...]] = field(default_factory=dict)
    seconds: float = field(default=0.0, compare=False)

    def observations(self, metric: str) -> list[float]:
        """Return the values of `metric` in the complete evaluations of the stages `ESTIMATING`."""
        return [
            evaluation.outcome.metrics[metric]
            for evaluation in self.evaluations
            if evaluation.stage in ESTIMATING and evaluation.outcome.complete
        ]

    def mean(self, metric: str) -> float | None:
        """Return the mean of `observations`; None without any, which is so for a repetition."""
        values = self.observations(metric)
        return sum(values) / len(values) if values else None

    @property
    def proposed_as(self) -> str:
        """How it was proposed, without the run that it was carried over from."""
        return self.origin.partition(" (")[0]

    @property
    def unusable(self) -> bool:
        """Whether it failed only for reasons that say nothing about its parameters."""
        return self.state is TrialState.FAILED and all(
            evaluation.outcome.unusable
            for evaluation in self.evaluations
            if not evaluation.outcome.complete
        )

    @property
    def was_withdrawn(self) -> bool:
        """Whether somebody has taken back what its runs say; see `withdrawn`."""
        return any(e.outcome.notes.unusable is Unusable.WITHDRAWN for e in self.evaluations)

    @property
    def disturbed(self) -> bool:
        """Whether it is unusable, but no node was lost, which may have died of the parameters."""
        return self.unusable and all(
            evaluation.outcome.state is not EvaluationState.LOST for evaluation in self.evaluations
        )

    @property
    def ending(self) -> str:
        """How it ended, in a word: its state; if it is unusable, lost or as `Unusable` says."""
        if not self.unusable:
            return str(self.state)
        endings = [e.outcome.ending for e in self.evaluations if e.outcome.unusable]
        lost = str(EvaluationState.LOST)
        return lost if lost in endings or not endings else endings[-1]

    @property
    def parameter_set(self) -> ParameterSet:
        """The parameters as a hashable key, which trials of equal ones share."""
        return parameter_set(self.parameters)

    @property
    def failed_again(self) -> bool:
        """Whether it failed for its parameters when it was checked or run again."""
        outcomes = [e.outcome for e in self.evaluations if e.stage in CHECKS]
        return any(not outcome.complete and not outcome.unusable for outcome in outcomes)

    @property
    def unchecked(self) -> "Trial":
        """The trial without the evaluations that checked it as a candidate, and their outcome."""
        tuning = tuple(e for e in self.evaluations if e.stage in TUNING)
        if self.failed_again and all(e.outcome.complete for e in tuning):
            return replace(self, evaluations=tuning, state=TrialState.COMPLETE, reason="")
        return replace(self, evaluations=tuning)


def withdrawn(trial: Trial, reason: str) -> Trial:
    """Return a trial of which somebody has said that its runs say nothing of its parameters."""
    why = f"withdrawn: {reason}"
    outcome = Outcome(EvaluationState.FAILED, reason=why, notes=Notes(unusable=Unusable.WITHDRAWN))
    return replace(
        trial,
        state=TrialState.FAILED,
        reason=why,
        evaluations=tuple(replace(e, outcome=outcome) for e in trial.evaluations),
        worst_cases={},
    )


def ended_as(outcome: Outcome) -> TrialState:
    """Return how a trial has ended that ended with an evaluation which is not complete."""
    return TrialState.CUT_SHORT if outcome.was_cut_short else TrialState.FAILED


def count_trials(trials: Iterable[Trial]) -> int:
    """Return how many trials count for the budget; one that is `Trial.unusable` does not."""
    return sum(not trial.unusable for trial in trials)


def count_evaluations(trials: Iterable[Trial]) -> int:
    """Return how many evaluations count for the budget: without checks, of `count_trials`."""
    return sum(
        e.stage in TUNING for trial in trials if not trial.unusable for e in trial.evaluations
    )


def count_checks(trials: Iterable[Trial]) -> int:
    """Return how many evaluations check the trials as candidates."""
    return sum(e.stage in CHECKS for trial in trials for e in trial.evaluations)


def evaluations_of(
    evaluations: Iterable[Evaluation], parameters: Mapping[str, Value]
) -> list[Evaluation]:
    """Return the evaluations of exactly these parameters, in their order."""
    key = parameter_set(parameters)
    return [evaluation for evaluation in evaluations if evaluation.parameter_set == key]


def latest_by_place(
    evaluations: Iterable[Evaluation], stages: Container[Stage]
) -> dict[int, dict[int, Evaluation]]:
    """Return evaluations of some stages by number of their trial, then by index in it.

    A later one of the same place replaces one that a kill left behind.
    """
    by_trial: dict[int, dict[int, Evaluation]] = {}
    for evaluation in evaluations:
        if evaluation.stage in stages:
            by_trial.setdefault(evaluation.trial, {})[evaluation.index] = evaluation
    return by_trial


def pooled(trials: Iterable[Trial]) -> list[Trial]:
    """Join the trials of each parameter set, such as its repetitions, into its first one.

    The joint trial has the usable evaluations and the latest estimate of the worst case. It has
    failed if one of its usable trials has.

    Parameters
    ----------
    trials
        In the order of the run.
    """
    sets: dict[ParameterSet, list[Trial]] = {}
    for trial in trials:
        sets.setdefault(trial.parameter_set, []).append(trial)
    return [_joint(of_set) for of_set in sets.values()]


def _joint(trials: Sequence[Trial]) -> Trial:
    first, *others = trials
    informative = [trial for trial in trials if not trial.unusable]
    if not others or not informative:
        return first
    failed = [trial for trial in informative if trial.state is TrialState.FAILED]
    latest = failed[-1] if failed else informative[0]
    return replace(
        informative[0],
        state=latest.state,
        reason=latest.reason,
        evaluations=tuple(e for t in trials for e in t.evaluations if not e.outcome.unusable),
        worst_cases={name: worst for t in trials for name, worst in t.worst_cases.items()},
    )
