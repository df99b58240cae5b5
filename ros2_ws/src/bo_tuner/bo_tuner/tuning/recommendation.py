"""The recommended parameter set, after a check of the best candidates on fresh draws.

Candidates are selected by noisy evaluations, so the estimates from these are too optimistic. They
are therefore evaluated again, in fresh contexts from the distribution and, with fresh noise, in
their estimated worst context. These evaluations are added to the trial, and `rank` decides among
the candidates that passed the check.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from bo_tuner.backends.protocol import Backend
from bo_tuner.models.fitting import DEFAULT_MODELS, ModelOptions
from bo_tuner.numerics.seeds import Stream, generator, noise_seed
from bo_tuner.optimizers.ranking import Candidate, rank
from bo_tuner.study.study import Study
from bo_tuner.trials import Context, Evaluation, Stage, Trial, WorstCase
from bo_tuner.tuning.evaluation import Losses, evaluate
from bo_tuner.tuning.limits import judge_sample, judge_samples, refuted
from bo_tuner.tuning.observer import NOBODY, RunObserver
from bo_tuner.tuning.passed_over import PassedOver

DRAWN_EVALUATIONS = 10
WORST_EVALUATIONS = 10


def most_check_evaluations(study: Study) -> int:
    """Return the largest number of evaluations in the check of a candidate."""
    return DRAWN_EVALUATIONS + WORST_EVALUATIONS * len(study.worst_case_constraints)


@dataclass(frozen=True)
class Recommendation:
    """The recommendation of a run.

    Attributes
    ----------
    candidate
        The recommended trial, the evaluations of its check included. If none passed its check, the
        first in rank that is believed feasible and was not checked, or else the least violating
        one.
    feasible
        Whether it passed its check; with no checks allowed, whether it is believed feasible.
    checked
        Numbers of the checked trials, in the order of the checks.
    ranked
        All candidates, with the evaluations of the checks.
    passed_over
        Better ones that were not chosen, by models that pool all evaluations; the best one first.
    """

    candidate: Candidate
    feasible: bool
    checked: tuple[int, ...]
    ranked: tuple[Candidate, ...] = field(repr=False)
    passed_over: tuple[PassedOver, ...] = ()


def recommend(
    study: Study,
    backend: Backend,
    trials: Sequence[Trial],
    options: ModelOptions = DEFAULT_MODELS,
    *,
    most_checked: int = 6,
    observer: RunObserver = NOBODY,
) -> Recommendation | None:
    """Check the best candidates on fresh draws and recommend one.

    The trials are ranked again after each check, until the first in rank has passed its check.

    Parameters
    ----------
    study, trials, options
        As in `rank`.
    backend
        Runs the evaluations; open.
    most_checked
        Largest number of candidates to check; with 0 the first in rank is recommended unchecked.
    observer
        Is passed each evaluation, and each checked candidate as a step.

    Returns
    -------
    Recommendation or None
        None if no trial is complete.

    Raises
    ------
    RunError
        If three evaluations in a row were lost with their nodes or disturbed.
    """
    latest = {trial.number: trial for trial in trials}
    held: set[int] = set()
    checked: list[int] = []
    while True:
        ranked = rank(study, list(latest.values()), options)
        if not ranked:
            return None
        # In a space smaller than the budget trials repeat a set, which has one check all the same.
        sets = {latest[number].parameter_set for number in checked}
        open_ones = [
            candidate
            for candidate in ranked
            if candidate.believed_feasible
            and (candidate.trial.number in held or candidate.trial.parameter_set not in sets)
        ]
        if not open_ones:
            break
        best = open_ones[0]
        if best.trial.number in held or most_checked == 0:
            return Recommendation(best, True, tuple(checked), tuple(ranked))
        if len(checked) == most_checked:
            break
        trial, holds = _check(study, backend, best.trial, observer)
        latest[trial.number] = trial
        checked.append(trial.number)
        if holds:
            held.add(trial.number)
        observer.advance()
    kept = next((candidate for candidate in ranked if candidate.trial.number in held), None)
    if kept is not None:
        return Recommendation(kept, kept.believed_feasible, tuple(checked), tuple(ranked))
    # Among several within the limits the first in rank, not the one with the largest margin: a
    # machine that hardly moves keeps every limit.
    crashed = {c.trial.parameter_set for c in ranked if c.trial.failed_again}
    others = [c for c in ranked if c.trial.parameter_set not in crashed] or ranked
    least = open_ones[0] if open_ones else min(others, key=lambda c: max(c.violation, 0.0))
    return Recommendation(least, False, tuple(checked), tuple(ranked))


def with_check(study: Study, trial: Trial, check: Sequence[Evaluation]) -> tuple[Trial, bool]:
    """Add the evaluations of a check to a trial, and judge all constraints.

    A check that is not complete is not passed, and leaves the estimated worst case as it is.

    Parameters
    ----------
    study
        The study.
    trial
        The trial before the check.
    check
        Evaluations of the check, up to the first that is not complete.

    Returns
    -------
    trial
        With the evaluations of the check and the worst case estimated from them.
    passed
        Whether the check is complete and all constraints hold.
    """
    extended = replace(trial, evaluations=trial.evaluations + tuple(check))
    completed = len(check) == _size(trial) and all(e.outcome.complete for e in check)
    if not completed:
        return extended, False
    holds = all(
        judge_sample(chance, extended.observations(chance.metric)).agrees
        for chance in study.chance_constraints
    )
    samples = judge_samples(study, [e for e in check if e.stage is Stage.CHECK_DRAWN])
    repeated = [e for e in check if e.stage is Stage.CHECK_WORST]
    found: dict[str, WorstCase] = {}
    for constraint in study.worst_case_constraints:
        worst = trial.worst_cases.get(constraint.name)
        if worst is None:
            continue
        there = _values([e for e in repeated if e.context == worst.context], constraint.metric)
        holds = holds and not refuted(constraint, there) and samples[constraint.name].agrees
        found[constraint.name] = replace(
            worst,
            value=float(np.mean(there)),
            observed=constraint.farthest([worst.observed, *there]),
        )
    return replace(extended, worst_cases=found), holds


def _check(
    study: Study, backend: Backend, trial: Trial, observer: RunObserver
) -> tuple[Trial, bool]:
    """Run the check of a trial until an evaluation fails; return as `with_check`.

    One that tells nothing of the parameters, since its nodes were lost or others disturbed it, is
    run again.
    """
    contexts = study.context_space()
    drawn = contexts.draw_stratified(
        DRAWN_EVALUATIONS, generator(study.seed, Stream.CHECK_CONTEXTS, trial.number)
    )
    plan: list[tuple[Stage, Context]] = [
        (Stage.CHECK_DRAWN, contexts.to_dict(row)) for row in drawn
    ]
    for worst_context in _worst_contexts(trial):
        plan += [(Stage.CHECK_WORST, worst_context)] * WORST_EVALUATIONS
    check: list[Evaluation] = []
    losses = Losses("evaluations of the check")
    for index, (stage, context) in enumerate(plan, start=len(trial.evaluations)):
        seed = noise_seed(study.seed, Stream.CHECK_NOISE, trial.number, index)
        planned = Evaluation(trial.number, index, stage, trial.parameters, context, seed)
        while (evaluation := evaluate(backend, planned, observer)).outcome.spoilt:
            losses.note(evaluation)
            losses.check()
        losses.note(evaluation)
        check.append(evaluation)
        if not evaluation.outcome.complete:
            break
    return with_check(study, trial, check)


def _size(trial: Trial) -> int:
    """Return the number of evaluations in the check of a trial."""
    return DRAWN_EVALUATIONS + WORST_EVALUATIONS * len(_worst_contexts(trial))


def _worst_contexts(trial: Trial) -> list[Context]:
    """Return the different worst contexts of a trial, in the order of the constraints."""
    found: list[Context] = []
    for worst in trial.worst_cases.values():
        if dict(worst.context) not in found:
            found.append(dict(worst.context))
    return found


def _values(evaluations: Sequence[Evaluation], metric: str) -> list[float]:
    return [e.outcome.metrics[metric] for e in evaluations]
