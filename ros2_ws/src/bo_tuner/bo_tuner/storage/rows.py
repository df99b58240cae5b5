"""From rows of a journal to evaluations and trials, or a refusal of what this program never writes.

A checksum shows damage by a disk, but not that another program has written the row.
"""

import json
import math
from collections.abc import Iterable, Mapping
from typing import Any

from bo_tuner import maxima
from bo_tuner.codec import checks
from bo_tuner.codec.findings import under
from bo_tuner.codec.reading import JSON, STUDY, Form, read
from bo_tuner.codec.rules import Count
from bo_tuner.codec.writing import changes
from bo_tuner.errors import ParameterError, StudyError
from bo_tuner.metrics.collect import LARGEST_METRIC, metric_problem
from bo_tuner.plans import Event, EventKind, Withdrawal
from bo_tuner.processor_load import Load
from bo_tuner.run_notes import Notes
from bo_tuner.study.study import Study
from bo_tuner.trials import (
    Context,
    Evaluation,
    EvaluationState,
    Outcome,
    Stage,
    Trial,
    TrialState,
    Value,
    WorstCase,
)

Row = Mapping[str, object]

_Texts = Mapping[str, str]
_Numbers = Mapping[str, float]
_Values = Mapping[str, Value]


def provenance_of(row: Row) -> dict[str, str]:
    """Make the provenance of a session."""
    provenance: dict[str, str] = _json(_Texts, row, "provenance")
    return provenance


def evaluation_of(row: Row) -> Evaluation:
    """Make an evaluation."""
    state, reason = _cell(EvaluationState, row, "state"), _cell(str, row, "reason")
    metrics = _json(_Numbers, row, "metrics")
    problems = {name: problem for name in metrics if (problem := metric_problem(metrics[name]))}
    if problems:
        # An earlier version recorded metrics that are refused today.
        name, problem = next(iter(problems.items()))
        state, metrics, reason = EvaluationState.FAILED, {}, f"metric {name} is {problem}"
    load, notes = _json(Load | None, row, "load"), _json(Notes, row, "notes", JSON)
    if missing := [name for name, value in notes.at_least.items() if math.isnan(value)]:
        place = ("notes", "at_least", missing[0])
        raise StudyError("expected a number, found nothing", place)
    return Evaluation(
        trial=_cell(Count, row, "trial"),
        index=_cell(Count, row, "position"),
        stage=_cell(Stage, row, "stage"),
        parameters=_json(_Values, row, "parameters"),
        context=_json(_Values, row, "context"),
        seed=_cell(Count, row, "seed"),
        outcome=Outcome(state, metrics, reason, _json(_Texts, row, "details"), load, notes),
        seconds=_cell(float, row, "seconds"),
    )


def event_of(row: Row) -> Event:
    """Make an event."""
    phase, detail = _cell(str, row, "phase"), _cell(str, row, "detail")
    return Event(phase, _cell(Count, row, "tasks"), _cell(EventKind, row, "kind"), detail)


def withdrawal_of(event: Event) -> tuple[int, str]:
    """Return the number of the trial that was withdrawn, and the reason."""
    withdrawal: Withdrawal = _json(Withdrawal, {"detail": event.detail}, "detail", JSON)
    return withdrawal.trial, withdrawal.reason


def trial_of(row: Row, evaluations: tuple[Evaluation, ...]) -> Trial:
    """Make a trial."""
    state, reason = _cell(TrialState, row, "state"), _cell(str, row, "reason")
    worst_cases: dict[str, WorstCase] = {}
    failed = [e for e in evaluations if not e.outcome.complete]
    if state is TrialState.COMPLETE and failed:
        state, reason = TrialState.FAILED, failed[0].outcome.reason
    else:
        worst_cases = _json(Mapping[str, WorstCase], row, "worst_cases")
    return Trial(
        number=number_of(row),
        parameters=_json(_Values, row, "parameters"),
        origin=_cell(str, row, "origin"),
        state=state,
        reason=reason,
        evaluations=evaluations,
        worst_cases=worst_cases,
        warnings=_json(tuple[str, ...], row, "warnings"),
        hyperparameters=_json(Mapping[str, tuple[float, ...]], row, "hyperparameters"),
        seconds=_cell(float, row, "seconds"),
    )


def number_of(row: Row) -> int:
    """Return the number of a trial."""
    number: int = _cell(Count, row, "number")
    return number


def evaluations_of(row: Row) -> int:
    """Return the number of evaluations of a trial."""
    count: int = _cell(Count, row, "evaluations")
    return count


def check_study(study: Study, evaluations: Iterable[Evaluation], trials: Iterable[Trial]) -> None:
    """Refuse evaluations and trials that cannot be of a study."""
    space, contexts = study.search_space(), study.context_space()
    searched = {constraint.name for constraint in study.worst_case_constraints}
    known: set[str] = set()

    def check_parameters(parameters: Mapping[str, Value]) -> None:
        key = repr(parameters)
        if key in known:
            return
        try:
            expected = space.completed(parameters)
        except ParameterError as error:
            raise ValueError(str(error)) from error
        if expected != parameters:
            raise ValueError("other values of tied or fixed parameters")
        known.add(key)

    def check_context(context: Context) -> None:
        _same_names(context, study.contexts, "context")
        try:
            numbers = contexts.rows([context])[0]
        except ParameterError as error:
            raise ValueError(f"context: {error}") from error
        _check_size(numbers.tolist(), "context")

    for evaluation in evaluations:
        outcome = evaluation.outcome
        complete = outcome.complete
        try:
            check_parameters(evaluation.parameters)
            check_context(evaluation.context)
            _same_names(outcome.metrics, study.metrics if complete else (), "metrics")
            bounded = outcome.notes.at_least
            _same_names(bounded, set(bounded) & set(study.metrics), "notes")
            _check_size(outcome.metrics.values(), "metrics")
            for objective in study.objectives if complete else ():
                if not math.isfinite(float(objective.to_cost(outcome.metrics[objective.metric]))):
                    raise ValueError(f"{objective.metric} has no {objective.scale} scale")
        except ValueError as error:
            where = f"test run {evaluation.index} of trial {evaluation.trial}"
            raise ValueError(f"{where}: {error}") from error
    for trial in trials:
        complete = trial.state is TrialState.COMPLETE
        states = [evaluation.outcome.state for evaluation in trial.evaluations]
        try:
            check_parameters(trial.parameters)
            if not states or complete != all(s is EvaluationState.COMPLETE for s in states):
                raise ValueError(f"is {trial.state}, unlike its test runs")
            _same_names(trial.worst_cases, searched if complete else (), "worst_cases")
            for worst_case in trial.worst_cases.values():
                check_context(worst_case.context)
                _check_size((worst_case.observed,), "worst_cases")
                # Estimates may lie above all metrics.
                _check_size((worst_case.value, worst_case.noise), "worst_cases", maxima.RESPONSE)
            if any(evaluation.parameters != trial.parameters for evaluation in trial.evaluations):
                raise ValueError("has test runs of other parameters")
        except ValueError as error:
            raise ValueError(f"trial {trial.number}: {error}") from error


def notes_text(notes: Notes) -> str:
    """Return notes as their column has them: what differs from those of a run without any."""
    # Texts of others may have half a character.
    return json.dumps(changes(notes), ensure_ascii=False).encode(errors="replace").decode()


def _cell(hint: Any, row: Row, column: str) -> Any:
    with under(column):
        return read(hint, row[column])


def _json(hint: Any, row: Row, column: str, form: Form = STUDY) -> Any:
    with under(column):
        try:
            return read(hint, json.loads(checks.text(row[column])), form)
        except StudyError:
            raise
        except (ValueError, RecursionError) as error:
            raise StudyError(str(error)) from error


def _check_size(values: Iterable[float], what: str, largest: float = LARGEST_METRIC) -> None:
    for value in values:
        if not abs(value) <= largest:
            raise ValueError(f"{what}: {value:g} is beyond {largest:g}")


def _same_names(names: Iterable[str], expected: Iterable[str], what: str) -> None:
    odd = sorted(set(names) ^ set(expected))
    if odd:
        raise ValueError(f"{what}: {checks.quoted(odd[0])} is missing or unknown")
