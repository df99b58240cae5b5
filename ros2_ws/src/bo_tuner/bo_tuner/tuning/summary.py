"""The result of a run, made from its record.

A run that ends and a reader who finds no usable ``summary.json`` take the same steps: recommend,
validate, summarize. The reader's evaluations all come from the journal.
"""

import json
from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

from bo_tuner.backends.recorded import RecordedEvaluations
from bo_tuner.codec.reading import JSON, read
from bo_tuner.codec.writing import to_json
from bo_tuner.errors import RunError
from bo_tuner.methods.protocol import Method
from bo_tuner.methods.recommendation import Recommendation
from bo_tuner.methods.stopping import StopAdvice, StopAdvisor
from bo_tuner.plans import ON_REQUEST, TIME_UP, Phase, Phases, finish_in, finished_after
from bo_tuner.storage.provenance import study_sha256
from bo_tuner.storage.record import RunRecord
from bo_tuner.storage.run_folder import SUMMARY
from bo_tuner.study.study import Study
from bo_tuner.trials import (
    TUNING,
    Evaluation,
    Trial,
    parameter_set,
)
from bo_tuner.tuning.driver import Driver
from bo_tuner.tuning.effects import ParameterEffects, effects_in
from bo_tuner.tuning.front import pareto_front
from bo_tuner.tuning.loop import trials_are_over
from bo_tuner.tuning.prospects import Prospects, prospects_in
from bo_tuner.tuning.recorded_method import recorded_method
from bo_tuner.tuning.validation import Validation, ValidationPlan


@dataclass(frozen=True)
class Conclusion:
    """What the trials of a run lead to: the recommendation, and the validation of it.

    Attributes
    ----------
    recommendation
        The recommended trial.
    default, tuned
        Validation of the hand-tuned parameter set and of the recommended one.
    effects
        Effects of each tuned parameter that the trials show.
    prospects
        What the models expect elsewhere; None where a feasible parameter set was found.
    """

    recommendation: Recommendation
    default: Validation
    tuned: Validation
    effects: tuple[ParameterEffects, ...]
    prospects: Prospects | None = None


def concluding(
    study: Study, method: Method, trials: Sequence[Trial], finished: int | None = None
) -> Phases[Conclusion | None]:
    """Yield the plans that check the best candidates, and validate the recommended one.

    It is validated beside the default, unless the method forbids to run that. Each plan is carried
    out before the next is asked for.
    """
    search = method.answer_search(study, trials, None)
    search.finished = finished
    yield search
    best = search.answer
    if best is None:
        return None
    default = study.search_space().defaults
    spared = () if method.runs_again(study, trials, default) else (0,)
    validation = ValidationPlan(study, [default, best.candidate.trial.parameters], spared)
    yield validation
    of_default, of_tuned = validation.results
    prospects = None
    if not (best.feasible and of_tuned.feasible):
        prospects = prospects_in(study, method.ranking.models(study, trials))
    return Conclusion(best, of_default, of_tuned, effects_in(study, trials), prospects)


def conclude(
    study: Study,
    driver: Driver,
    method: Method,
    trials: Sequence[Trial],
    finished: int | None = None,
) -> Conclusion | None:
    """Carry out what follows the trials, see `concluding`; returns what that does."""
    plans = concluding(study, method, trials, finished)
    while True:
        try:
            driver.complete(next(plans))
        except StopIteration as end:
            conclusion: Conclusion | None = end.value
            return conclusion


def continued(
    study: Study,
    method: Method,
    trials: Sequence[Trial],
    evaluations: Sequence[Evaluation],
    *,
    stop_early: bool,
    finished: int | None = None,
) -> list[Trial]:
    """Return the trials of a run on record as its next step is to know them.

    For a method to which they are data, they have the repetitions of a run that had ended. A run
    that may stop early does without: whether trials are to come is not known before they are
    judged.
    """
    if stop_early:
        return list(trials)
    more = not trials_are_over(study, trials, finished)
    return method.continued(trials, evaluations, more=more)


def choose_answer(
    study: Study,
    driver: Driver,
    method: Method,
    trials: Sequence[Trial],
    *,
    most_repeated: int | None = None,
) -> Recommendation | None:
    """Evaluate the best candidates again, by the method's rule, and recommend one."""
    search = method.answer_search(study, trials, most_repeated)
    driver.complete(search)
    return search.answer


def summarize(
    study: Study,
    conclusion: Conclusion,
    advice: StopAdvice | None,
    *,
    stop_early: bool,
    finish: str | None,
    trials: int,
    evaluations: int,
) -> dict[str, object]:
    """Return the content of ``summary.json`` but for the verdict."""
    best, default, tuned = conclusion.recommendation, conclusion.default, conclusion.tuned
    content = {
        "study_sha256": study_sha256(study),
        "trials": trials,
        "evaluations": evaluations,
        "trial": best.candidate.trial.number,
        "passed_check": best.feasible,
        "checked_trials": best.checked,
        "ranked_trials": sorted(candidate.trial.number for candidate in best.ranked),
        "passed_over": best.passed_over,
        "biases": best.biases,
        "predicted_objective": best.candidate.objective,
        "predicted_feasibility": best.candidate.feasibility,
        "default": default,
        "tuned": tuned,
        "effects": conclusion.effects,
        "prospects": conclusion.prospects,
        "stop_advice": advice,
        "stopped_early": stop_early and advice is not None,
        "ended_on_request": finish == ON_REQUEST,
        "ended_by_time": finish == TIME_UP,
    }
    if len(study.objectives) > 1:
        content["front"] = pareto_front(study, best.ranked)
    # As it will be read from the file.
    as_read: dict[str, object] = json.loads(json.dumps(to_json(content), allow_nan=False))
    return as_read


def with_summary(record: RunRecord, warn: Callable[[str], None]) -> RunRecord:
    """Return a record with the summary of its file if that is one of this record, or made anew."""
    if record.summary is not None and _belongs(record.summary, record):
        return record
    made = summary_from_record(record)
    path = record.path / SUMMARY
    if path.exists() or path.is_symlink() or made is not None:
        how = "not the summary of this record" if path.exists() else "missing"
        done = "ignored, since the run has not ended" if made is None else "made from the journal"
        warn(f"warning: {path}: {how}; {done}")
    return replace(record, summary=made)


def summary_from_record(record: RunRecord) -> dict[str, object] | None:
    """Return the summary of a run from its journal alone; None if the run has not ended."""
    study, method = record.study, recorded_method(record)
    over = trials_are_over(study, record.trials, record.finished)
    if not over and not record.options.stop_early:
        return None
    advisor = StopAdvisor(study, method)
    for count in range(1, len(record.trials) + 1):
        advisor.consider(record.trials[:count])
    if not over and advisor.advice is None:
        return None
    # Evaluations of trials are left out, and those that were lost and then run again.
    kept = {_place(item) for item in record.evaluations if not item.outcome.unusable}
    later = [
        item
        for item in record.evaluations
        if item.stage not in TUNING and not (item.outcome.unusable and _place(item) in kept)
    ]
    try:
        backend = RecordedEvaluations(_Nothing(), study, later)
        trials = continued(
            study,
            method,
            record.trials,
            record.evaluations,
            stop_early=record.options.stop_early,
            finished=record.finished,
        )
        driver = Driver(backend, window=record.options.window)
        finished = finished_after(record.events, Phase.CHECKING)
        conclusion = conclude(study, driver, method, trials, finished)
    except (_NotOnRecordError, RunError, KeyError):
        return None
    if conclusion is None:
        return None
    return summarize(
        study,
        conclusion,
        advisor.advice,
        stop_early=record.options.stop_early,
        finish=finish_in(record.events),
        trials=len(record.trials),
        evaluations=len(record.evaluations),
    )


def _place(evaluation: Evaluation) -> Hashable:
    """Return what an evaluation has in common with one that repeats it.

    In a run that was continued, another parameter set may be validated in the same places.
    """
    place = (evaluation.stage, evaluation.trial, evaluation.index, evaluation.seed)
    return (*place, evaluation.parameter_set)


def _belongs(summary: Mapping[str, object], record: RunRecord) -> bool:
    """Return whether a summary has the form that `summarize` gives it, and is of this record."""
    expected = {
        "study_sha256": study_sha256(record.study),
        "trials": len(record.trials),
        "evaluations": len(record.evaluations),
    }
    if any(repr(summary.get(key)) != repr(value) for key, value in expected.items()):
        return False
    number, flags = summary.get("trial"), ("passed_check", "stopped_early")
    if type(number) is not int or not 0 <= number < len(record.trials):
        return False
    if any(type(summary.get(key)) is not bool for key in flags):
        return False
    try:
        default, tuned = (read(Validation, summary[key], JSON) for key in ("default", "tuned"))
    except (KeyError, ValueError):
        return False
    sides = (
        (default, record.study.search_space().defaults),
        (tuned, record.trials[number].parameters),
    )
    return all(
        parameter_set(validation.parameters) == parameter_set(parameters)
        and validation.constraints.keys() == record.study.constraints.keys()
        for validation, parameters in sides
    )


class _NotOnRecordError(Exception):
    pass


class _Nothing:
    """A backend that has nothing to run on."""

    name = "record"

    def open(self) -> None:
        pass

    def run(self, evaluations: Iterable[Evaluation]) -> Iterator[Evaluation]:
        for _ in evaluations:
            raise _NotOnRecordError
        return iter(())

    def close(self) -> None:
        pass
