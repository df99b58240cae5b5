"""From rows of a journal to evaluations and trials, or a refusal of what this program never writes.

A checksum shows damage by a disk, but not that another program has written the row.
"""

import json
import math
from collections.abc import Iterable, Mapping, Sequence

from bo_tuner import maxima
from bo_tuner.codec import checks
from bo_tuner.errors import ParameterError
from bo_tuner.metrics.collect import LARGEST_METRIC, metric_problem
from bo_tuner.plans import Event, EventKind
from bo_tuner.processor_load import Load
from bo_tuner.run_notes import Notes
from bo_tuner.storage.typed_json import from_json, to_json
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

_BLANK = to_json(Notes())


def provenance_of(row: Row) -> dict[str, str]:
    """Make the provenance of a session.

    Raises
    ------
    ValueError
        If the row is not one that this program writes to a journal.
    """
    return _texts(row, "provenance")


def evaluation_of(row: Row) -> Evaluation:
    """Make an evaluation."""
    state, reason = EvaluationState(_text(row, "state")), _text(row, "reason")
    metrics = {name: float(value) for name, value in _numbers(row, "metrics").items()}
    problems = {name: problem for name in metrics if (problem := metric_problem(metrics[name]))}
    if problems:
        # An earlier version recorded metrics that are refused today.
        name, problem = next(iter(problems.items()))
        state, metrics, reason = EvaluationState.FAILED, {}, f"metric {name} is {problem}"
    outcome = Outcome(state, metrics, reason, _texts(row, "details"), _load(row), _notes(row))
    return Evaluation(
        trial=_count(row, "trial"),
        index=_count(row, "position"),
        stage=Stage(_text(row, "stage")),
        parameters=_values(row, "parameters"),
        context=_values(row, "context"),
        seed=_count(row, "seed"),
        outcome=outcome,
        seconds=float(_number(row["seconds"], "seconds")),
    )


def event_of(row: Row) -> Event:
    """Make an event."""
    kind = EventKind(_text(row, "kind"))
    return Event(_text(row, "phase"), _count(row, "tasks"), kind, _text(row, "detail"))


def trial_of(row: Row, evaluations: tuple[Evaluation, ...]) -> Trial:
    """Make a trial."""
    state, reason = TrialState(_text(row, "state")), _text(row, "reason")
    worst_cases: dict[str, WorstCase] = {}
    failed = [e for e in evaluations if not e.outcome.complete]
    if state is TrialState.COMPLETE and failed:
        state, reason = TrialState.FAILED, failed[0].outcome.reason
    else:
        worst_cases = {
            name: _worst_case(content) for name, content in _object(row, "worst_cases").items()
        }
    return Trial(
        number=number_of(row),
        parameters=_values(row, "parameters"),
        origin=_text(row, "origin"),
        state=state,
        reason=reason,
        evaluations=evaluations,
        worst_cases=worst_cases,
        warnings=tuple(_as_text(item, "warnings") for item in _list(row, "warnings")),
        hyperparameters={
            name: tuple(float(_number(phi, "hyperparameters")) for phi in _sequence(values))
            for name, values in _object(row, "hyperparameters").items()
        },
        seconds=float(_number(row["seconds"], "seconds")),
    )


def number_of(row: Row) -> int:
    """Return the number of a trial."""
    return _count(row, "number")


def evaluations_of(row: Row) -> int:
    """Return the number of evaluations of a trial."""
    return _count(row, "evaluations")


def check_study(study: Study, evaluations: Iterable[Evaluation], trials: Iterable[Trial]) -> None:
    """Refuse evaluations and trials that cannot be of a study.

    Raises
    ------
    ValueError
        With the first one, and why.
    """
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


def _worst_case(content: object) -> WorstCase:
    if not isinstance(content, dict):
        raise ValueError(f"worst_cases: expected an object, found {checks.show(content)}")
    _same_names(content, ("value", "context", "observed", "noise"), "worst_cases")
    value, observed, noise = (
        float(_number(content[key], "worst_cases")) for key in ("value", "observed", "noise")
    )
    if noise < 0.0:
        raise ValueError(f"worst_cases: noise {noise}")
    return WorstCase(value, _as_values(content["context"], "worst_cases"), observed, noise)


def _load(row: Row) -> Load | None:
    content = _json(row, "load")
    try:
        return None if content is None else from_json(Load, content)
    except ValueError as error:
        raise ValueError(f"load: {error}") from error


def notes_text(notes: Notes) -> str:
    """Return notes as their column has them: what differs from those of a run without any."""
    content = to_json(notes)
    noted = {name: value for name, value in content.items() if value != _BLANK[name]}
    # Texts of others may have half a character.
    return json.dumps(noted, ensure_ascii=False).encode(errors="replace").decode()


def _notes(row: Row) -> Notes:
    try:
        notes = from_json(Notes, _BLANK | _object(row, "notes"))
        if missing := [name for name, value in notes.at_least.items() if math.isnan(value)]:
            raise ValueError(f"at_least.{missing[0]}: expected a number, found nothing")
    except ValueError as error:
        raise ValueError(f"notes: {error}") from error
    return notes


def _text(row: Row, column: str) -> str:
    return _as_text(row[column], column)


def _as_text(value: object, column: str) -> str:
    if not isinstance(value, str):
        raise ValueError(f"{column}: expected text, found {checks.show(value)}")
    return value


def _count(row: Row, column: str) -> int:
    value = row[column]
    if isinstance(value, bool) or not isinstance(value, int) or value < 0:
        raise ValueError(f"{column}: expected a count, found {checks.show(value)}")
    return value


def _number(value: object, column: str) -> int | float:
    if isinstance(value, int) and not isinstance(value, bool):
        if abs(value) < checks.INTEGER_LIMIT:
            return value
    elif isinstance(value, float) and math.isfinite(value):
        return value
    raise ValueError(f"{column}: expected a number, found {checks.show(value)}")


def _json(row: Row, column: str) -> object:
    try:
        return json.loads(_text(row, column))
    except (ValueError, RecursionError) as error:
        raise ValueError(f"{column}: {error}") from error


def _object(row: Row, column: str) -> dict[str, object]:
    value = _json(row, column)
    if not isinstance(value, dict):
        raise ValueError(f"{column}: expected an object, found {checks.show(value)}")
    return value


def _list(row: Row, column: str) -> Sequence[object]:
    return _sequence(_json(row, column))


def _sequence(value: object) -> Sequence[object]:
    if not isinstance(value, list):
        raise ValueError(f"expected a list, found {checks.show(value)}")
    return value


def _numbers(row: Row, column: str) -> dict[str, int | float]:
    return {name: _number(item, column) for name, item in _object(row, column).items()}


def _values(row: Row, column: str) -> dict[str, Value]:
    return _as_values(_object(row, column), column)


def _as_values(value: object, column: str) -> dict[str, Value]:
    if not isinstance(value, dict):
        raise ValueError(f"{column}: expected an object, found {checks.show(value)}")
    return {
        name: item if isinstance(item, (bool, str)) else _number(item, column)
        for name, item in value.items()
    }


def _texts(row: Row, column: str) -> dict[str, str]:
    return {name: _as_text(item, column) for name, item in _object(row, column).items()}


def _check_size(values: Iterable[float], what: str, largest: float = LARGEST_METRIC) -> None:
    for value in values:
        if not abs(value) <= largest:
            raise ValueError(f"{what}: {value:g} is beyond {largest:g}")


def _same_names(names: Iterable[str], expected: Iterable[str], what: str) -> None:
    odd = sorted(set(names) ^ set(expected))
    if odd:
        raise ValueError(f"{what}: {checks.quoted(odd[0])} is missing or unknown")
