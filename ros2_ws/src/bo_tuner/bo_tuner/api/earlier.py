"""Runs that were made by others, by whatever, as trials: ahead of a run, or while it goes on."""

import contextlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from bo_tuner.backends.function import Returned, failed
from bo_tuner.codec import checks
from bo_tuner.errors import MetricsError, ParameterError, RunRecordError, StudyError
from bo_tuner.methods.protocol import Method
from bo_tuner.storage.record import record_of_study
from bo_tuner.study.function_study import FUNCTION
from bo_tuner.study.study import Study
from bo_tuner.text import counted
from bo_tuner.trials import (
    Context,
    Evaluation,
    ParameterSet,
    Stage,
    Trial,
    TrialState,
    Value,
    count_evaluations,
    count_trials,
    parameter_set,
)
from bo_tuner.tuning.carrying import Carried, carry_over, with_worst_cases

EARLIER = "earlier"
"""Name of where they come from."""
ADDED = "added"
"""The same of one that comes while a run goes on."""


@dataclass(frozen=True)
class EarlierRun:
    """A run that was made before, by whatever.

    Attributes
    ----------
    parameters
        Its values by name; what is left out had the default.
    metrics
        As a function returns them; empty for a run that failed.
    context
        In which it was, by name; what is left out was nominal.
    failure
        Why it failed; empty if it did not.
    errors
        Known standard errors of metrics, by name, each in its unit.
    """

    parameters: Mapping[str, Value]
    metrics: Mapping[str, float] = field(default_factory=dict)
    context: Mapping[str, Value] = field(default_factory=dict)
    failure: str = ""
    errors: Mapping[str, float] = field(default_factory=dict)


def added_trial(
    study: Study, method: Method, run: EarlierRun
) -> Callable[[int, Sequence[Trial]], Trial]:
    """Return what makes a trial of a run, by its number and the trials before it.

    Raises as `first_trials`, at once.
    """
    (trial,) = _trials(study, [run])
    # What is no parameter set is refused below.
    with contextlib.suppress(ParameterError):
        whole = study.search_space().completed(trial.parameters)
        study.check_given(run.parameters, whole, "parameters")
    record = replace(record_of_study(study, Path(ADDED), FUNCTION), trials=(trial,))
    try:
        (taken,) = carry_over(record, study, method, run=ADDED).trials
    except RunRecordError as error:
        raise StudyError(str(error).rpartition("1 trial ")[2], ("parameters",)) from None

    def made(number: int, before: Sequence[Trial]) -> Trial:
        last = replace(taken, number=len(before))
        if taken.worst_cases:
            last = with_worst_cases(study, method, [*before, last], [len(before)])[-1]
        evaluations = (replace(e, trial=number) for e in taken.evaluations)
        return replace(last, number=number, origin=ADDED, evaluations=tuple(evaluations))

    return made


def first_trials(study: Study, method: Method, runs: Iterable[EarlierRun]) -> Carried | None:
    """Make trials of earlier runs, those of one parameter set in one; None of none.

    Nobody knows how their contexts were chosen: they count as those of a search, and not as drawn.

    Parameters
    ----------
    study, method
        Of the new run.
    runs
        The earlier ones.

    Raises
    ------
    StudyError
        If one has something that the study does not have, or no trial remains to be made.
    MetricsError
        If one has not a number for each metric.
    RunRecordError
        If the study permits none of their parameter sets.
    """
    if not isinstance(runs, Iterable):
        raise StudyError(f"expected a list of runs, found {checks.show(runs)}", (EARLIER,))
    if not (runs := list(runs)):
        return None
    if study.relative_metrics:
        raise StudyError("expected none, since limits are relative to the default", (EARLIER,))
    trials = _trials(study, runs)
    record = replace(record_of_study(study, Path(EARLIER), FUNCTION), trials=tuple(trials))
    carried = carry_over(record, study, method, run=f"{EARLIER} runs")
    count, evaluations = count_trials(carried.trials), count_evaluations(carried.trials)
    if study.budget.is_spent(count, evaluations):
        raise StudyError(
            f"expected more than the {counted(count, 'trial')} and "
            f"{counted(evaluations, 'test run')} of the earlier runs, which count",
            ("budget",),
        )
    return carried


def _trials(study: Study, runs: Iterable[EarlierRun]) -> list[Trial]:
    returned = Returned(study)
    by_set: dict[ParameterSet, list[Evaluation]] = {}
    for index, run in enumerate(runs):
        if not isinstance(run, EarlierRun):
            raise StudyError(f"expected an EarlierRun, found {checks.show(run)}", (EARLIER, index))
        try:
            values = _parameters(study, run.parameters)
            context = _context(study, run.context)
            outcome = (
                failed(checks.text(run.failure, "failure"))
                if run.failure
                else returned.outcome(run.metrics, run.errors)
            )
        except StudyError as error:
            raise error.under(EARLIER, index) from None
        except MetricsError as error:
            raise MetricsError(f"{EARLIER}[{index}]: {error}") from None
        of_set = by_set.setdefault(parameter_set(values), [])
        stage = Stage.SEARCH if study.contexts else Stage.DRAWN
        planned = Evaluation(len(by_set) - 1, len(of_set), stage, values, context, index)
        of_set.append(replace(planned, outcome=outcome))
    return [_trial(number, evaluations) for number, evaluations in enumerate(by_set.values())]


def _trial(number: int, evaluations: list[Evaluation]) -> Trial:
    problems = [e.outcome.reason for e in evaluations if not e.outcome.complete]
    return Trial(
        number,
        evaluations[0].parameters,
        EARLIER,
        TrialState.FAILED if problems else TrialState.COMPLETE,
        problems[0] if problems else "",
        tuple(replace(e, trial=number) for e in evaluations),
    )


def _parameters(study: Study, given: Mapping[str, Value]) -> dict[str, Value]:
    """Return a whole parameter set; a double may be given as an integer."""
    known = _known(given, study.parameters)
    values = {name: study.parameters[name].checked(value, name) for name, value in known.items()}
    return {**study.search_space().defaults, **values}


def _context(study: Study, given: Mapping[str, Value]) -> Context:
    space = study.context_space()
    return {**space.to_dict(space.nominal()), **_known(given, study.contexts)}


def _known(given: Mapping[str, Value], names: Iterable[str]) -> Mapping[str, Value]:
    checks.mapping(given)
    if unknown := [name for name in given if name not in names]:
        raise StudyError(f"unknown; expected one of {', '.join(names)}", (unknown[0],))
    return given
