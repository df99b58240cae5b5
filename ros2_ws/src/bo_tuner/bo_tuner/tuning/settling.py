"""The recommended parameter set of an algorithm whose models pool all evaluations.

Parameter sets are run again, a few runs at a time, until it is settled which one is the answer
(`bo_tuner.optimizers.repetition`) or the repetitions are used up. These runs are added to their
trials. No further check of the answer follows: the posterior that chooses it has them among its
data.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import replace

from bo_tuner.backends.protocol import Backend
from bo_tuner.models.fitting import ModelOptions
from bo_tuner.models.pooled_responses import EveryContext
from bo_tuner.models.surrogates import Surrogates
from bo_tuner.numerics.seeds import Stream, generator, noise_seed
from bo_tuner.optimizers.ranking import Candidate, ranked_by, ranking_models
from bo_tuner.optimizers.repetition import lacking, next_repetition
from bo_tuner.study.study import Study
from bo_tuner.trials import (
    CHECKS,
    TUNING,
    Context,
    Evaluation,
    Stage,
    Trial,
    TrialState,
    WorstCase,
    latest_by_place,
)
from bo_tuner.tuning.evaluation import Losses, evaluate
from bo_tuner.tuning.observer import NOBODY, RunObserver
from bo_tuner.tuning.passed_over import passed_over
from bo_tuner.tuning.recommendation import Recommendation, most_check_evaluations, with_check

SHARE = 1.0 / 6.0
"""Repetitions, at most, for each evaluation of the trials."""


def most_repetitions(study: Study, evaluations: int, made: int = 0) -> int:
    """Return the largest number of repetitions after trials with so many evaluations.

    They are a sixth as many, less those that were made already, and at least as many as the check
    of one candidate takes.
    """
    return max(most_check_evaluations(study), math.ceil(SHARE * evaluations) - made)


def before_repetitions(study: Study, evaluations: int) -> int:
    """Return how many of so many evaluations in all, at least one, are those of the trials."""
    return max(1, min(evaluations - most_check_evaluations(study), part_of_trials(evaluations)))


def part_of_trials(evaluations: int) -> int:
    """Return how many of so many evaluations are those of trials, with repetitions in proportion.

    An answer is known where a run is continued, so none are kept for the check of one.
    """
    return math.floor(evaluations / (1.0 + SHARE))


def settle(
    study: Study,
    backend: Backend,
    trials: Sequence[Trial],
    options: ModelOptions,
    *,
    most: int,
    observer: RunObserver = NOBODY,
) -> Recommendation | None:
    """Run parameter sets again until the answer is settled, and recommend it.

    Parameters
    ----------
    study, trials, options
        As in `rank`; repetitions that the trials have already are data, too.
    backend
        Runs the evaluations; open.
    most
        Largest number of further repetitions.
    observer
        Is passed each evaluation, which is a step.

    Returns
    -------
    Recommendation or None
        None if no trial is complete. ``checked`` are the trials that were run again.

    Raises
    ------
    RunError
        If three repetitions in a row were lost with their nodes or disturbed.
    """
    latest = {trial.number: trial for trial in trials}
    repeated = [t.number for t in trials for e in t.evaluations if e.stage in CHECKS]
    most += len(repeated)
    candidates: list[Candidate] = []
    losses = Losses("repetitions")
    while True:
        known = list(latest.values())
        models = ranking_models(study, known, options)
        before, candidates = candidates, ranked_by(models, study, known, options)
        if not candidates:
            # Every candidate has failed when it was run again.
            return (
                Recommendation(before[0], False, tuple(repeated), tuple(before)) if before else None
            )
        left = most - len(repeated)
        choice = next_repetition(study, models, candidates, left) if left else None
        if choice is None:
            candidates = _with_own_runs_first(study, models, candidates)
            best = candidates[0]
            return Recommendation(
                replace(best, trial=estimated(study, models, best.trial)),
                best.believed_feasible,
                tuple(dict.fromkeys(repeated)),
                tuple(candidates),
                passed_over(models, best, candidates),
            )
        number = choice.trial.number
        for _ in range(min(choice.runs, left)):
            evaluation = _run(study, backend, latest[number], choice.context, observer)
            latest[number] = with_repetitions(latest[number], [evaluation])
            repeated.append(number)
            losses.note(evaluation)
            losses.check()
            observer.advance()
            if not evaluation.outcome.complete:
                break


def _with_own_runs_first(
    study: Study, models: Surrogates, candidates: Sequence[Candidate]
) -> list[Candidate]:
    """Put the first candidate before the others that has the runs of its own which an answer needs.

    Where the repetitions are used up, a better one may have become the first without any. If none
    has them, the order stays.
    """
    for candidate in candidates:
        if not candidate.believed_feasible:
            break
        if not lacking(study, models, candidate.trial):
            return [candidate, *(c for c in candidates if c is not candidate)]
    return list(candidates)


def with_known_repetitions(
    trials: Sequence[Trial], evaluations: Sequence[Evaluation], *, more: bool
) -> list[Trial]:
    """Give the trials of a run that is continued the repetitions that its next trial can know.

    Parameters
    ----------
    trials
        Without the repetitions.
    evaluations
        All evaluations of the run, in the order of the record.
    more
        Whether trials are to come. If not, what was recorded after the last trial belongs to the
        search for the answer, which takes its way anew.
    """
    last = max((k for k, e in enumerate(evaluations) if e.stage in TUNING), default=0)
    known = repetitions_of(evaluations if more else evaluations[:last])
    return [with_repetitions(trial, known.get(trial.number, ())) for trial in trials]


def with_checks(
    study: Study,
    trials: Sequence[Trial],
    evaluations: Iterable[Evaluation],
    options: ModelOptions,
) -> list[Trial]:
    """Give trials what is on record of their checks or repetitions, as the ranking has to know it.

    A trial that failed when it was run again is no candidate. Worst cases are as they were
    estimated when the trials were run, or, without pooled models, when they were checked.

    Parameters
    ----------
    study
        The study.
    trials
        Without these evaluations.
    evaluations
        All evaluations of the run, in the order of the record.
    options
        As in `rank`.
    """
    known = repetitions_of(evaluations)
    if options.pooled:
        return [with_repetitions(trial, known.get(trial.number, ())) for trial in trials]
    return [with_check(study, trial, known.get(trial.number, ()))[0] for trial in trials]


def repetitions_of(evaluations: Iterable[Evaluation]) -> dict[int, list[Evaluation]]:
    """Return the evaluations on record that checked trials, by number of the trial."""
    found = latest_by_place(evaluations, CHECKS)
    return {trial: list(checks.values()) for trial, checks in found.items()}


def with_repetitions(trial: Trial, repetitions: Sequence[Evaluation]) -> Trial:
    """Add repetitions to a trial, which has failed if one of them did for its parameters."""
    extended = replace(trial, evaluations=(*trial.evaluations, *repetitions))
    for outcome in (evaluation.outcome for evaluation in repetitions):
        if not outcome.complete and not outcome.spoilt:
            return replace(extended, state=TrialState.FAILED, reason=outcome.reason)
    return extended


def estimated(study: Study, models: Surrogates, trial: Trial) -> Trial:
    """Return a trial with its worst cases as the models of all evaluations estimate them.

    Those estimated when it was run know nothing of the repetitions.
    """
    contexts = study.context_space()
    x = study.search_space().to_cube(trial.parameters)[None]
    worst_cases = dict(trial.worst_cases)
    for name in trial.worst_cases:
        # Of trials that have all failed when they were run again there is no model.
        constraint, response = study.constraints[name], models.constraints.get(name)
        if isinstance(response, EveryContext):
            row, value, noise = response.worst_case(x)
            context = contexts.to_dict(contexts.to_contexts(response.contexts[row])[0])
            values = [
                evaluation.outcome.metrics[constraint.metric]
                for evaluation in trial.evaluations
                if evaluation.outcome.complete
            ]
            worst_cases[name] = WorstCase(
                float(value[0]), context, constraint.farthest(values), float(noise[0])
            )
    return replace(trial, worst_cases=worst_cases)


def _run(
    study: Study,
    backend: Backend,
    trial: Trial,
    context: Context | None,
    observer: RunObserver,
) -> Evaluation:
    index, stage = len(trial.evaluations), Stage.CHECK_WORST
    if context is None:
        contexts, stage = study.context_space(), Stage.CHECK_DRAWN
        rng = generator(study.seed, Stream.CHECK_CONTEXTS, trial.number, index)
        context = contexts.to_dict(contexts.draw_stratified(1, rng)[0])
    seed = noise_seed(study.seed, Stream.CHECK_NOISE, trial.number, index)
    planned = Evaluation(trial.number, index, stage, trial.parameters, context, seed)
    return evaluate(backend, planned, observer)
