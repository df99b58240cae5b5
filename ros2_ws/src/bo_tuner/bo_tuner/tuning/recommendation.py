"""The last step before a recommendation: the best candidates again, on fresh draws.

A search picks winners, and the luck that made a trial a winner does not repeat. The candidates are
therefore cut again, in fresh contexts from the distribution and, with fresh noise, in the context
that is believed the worst. What is seen there joins the trial's record, and `rank` decides anew
among those that held.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from bo_tuner.backends.protocol import Backend
from bo_tuner.models.surrogates import DEFAULT_MODELS, ModelOptions
from bo_tuner.numerics.arrays import Array
from bo_tuner.numerics.seeds import Stream, generator, noise_seed
from bo_tuner.optimizers.ranking import Candidate, rank
from bo_tuner.study.parts import Constraint
from bo_tuner.study.study import Study
from bo_tuner.trials import Evaluation, EvaluationState, Stage, Trial
from bo_tuner.tuning.loop import EvaluationObserver, run_cut

DRAWN_CUTS = 10
WORST_CUTS = 10
CHECK_CUTS = DRAWN_CUTS + WORST_CUTS
"""Most evaluations of a candidate's check."""


@dataclass(frozen=True)
class Recommendation:
    """The answer of a run.

    Attributes
    ----------
    candidate
        The recommended trial with its checks. If none held, the first that is believed feasible
        and was not checked any more, or else the least violating one.
    feasible
        Whether it is believed feasible and held in the checks.
    checked
        Numbers of the trials that were checked, in that order.
    """

    candidate: Candidate
    feasible: bool
    checked: tuple[int, ...]


def recommend(
    study: Study,
    backend: Backend,
    trials: Sequence[Trial],
    options: ModelOptions = DEFAULT_MODELS,
    *,
    most_checked: int = 6,
    observe: EvaluationObserver = lambda evaluation, parameters: None,
    advance: Callable[[], None] = lambda: None,
) -> Recommendation | None:
    """Check the best candidates on fresh draws and recommend one.

    Each check joins the record and the ranking is made anew, until its first has been checked and
    held.

    Parameters
    ----------
    study, trials, options
        As in `rank`.
    backend
        Runs the evaluations; open.
    most_checked
        Most candidates to check; with 0 the first in rank is recommended as it is.
    observe
        Called after each evaluation.
    advance
        Called after each candidate.

    Returns
    -------
    Recommendation or None
        None if no trial is complete.
    """
    latest = {trial.number: trial for trial in trials}
    held: set[int] = set()
    checked: list[int] = []
    while True:
        ranked = rank(study, list(latest.values()), options)
        if not ranked:
            return None
        open_ones = [
            candidate
            for candidate in ranked
            if candidate.believed_feasible
            and (candidate.trial.number in held or candidate.trial.number not in checked)
        ]
        if not open_ones:
            break
        best = open_ones[0]
        if best.trial.number in held or most_checked == 0:
            return Recommendation(best, True, tuple(checked))
        if len(checked) == most_checked:
            break
        trial, holds = _check(study, backend, best.trial, observe)
        latest[trial.number] = trial
        checked.append(trial.number)
        if holds:
            held.add(trial.number)
        advance()
    for candidate in ranked:
        if candidate.trial.number in held:
            return Recommendation(candidate, True, tuple(checked))
    if open_ones:
        return Recommendation(open_ones[0], False, tuple(checked))
    # Of several within the limits the first in rank, not the one that stays the farthest away: a
    # machine that hardly moves keeps every limit.
    least = min(ranked, key=lambda c: max(c.violation, 0.0))
    return Recommendation(least, False, tuple(checked))


def _check(
    study: Study, backend: Backend, trial: Trial, observe: EvaluationObserver
) -> tuple[Trial, bool]:
    """Cut a trial again; returns it with the new evaluations, and whether all constraints held."""
    evaluations: list[Evaluation] = []

    def run(stage: Stage, context: Mapping[str, float]) -> bool:
        index = len(trial.evaluations) + len(evaluations)
        seed = noise_seed(study.seed, Stream.CHECK_NOISE, trial.number, index)
        planned = Evaluation(trial.number, index, stage, context, seed)
        evaluation = run_cut(study, backend, trial.parameters, planned)
        evaluations.append(evaluation)
        observe(evaluation, trial.parameters)
        return evaluation.outcome.state is EvaluationState.COMPLETE

    contexts = study.context_space()
    drawn = contexts.draw_stratified(
        DRAWN_CUTS, generator(study.seed, Stream.CHECK_CONTEXTS, trial.number)
    )
    plan = [(Stage.CHECK_DRAWN, contexts.to_dict(row)) for row in drawn]
    if trial.worst_case is not None:
        plan += [(Stage.CHECK_WORST, dict(trial.worst_case.context))] * WORST_CUTS
    whole = all(run(stage, context) for stage, context in plan)
    extended = replace(trial, evaluations=trial.evaluations + tuple(evaluations))
    holds = whole and all(_chance_holds(extended, c) for c in study.chance_constraints)
    constraint = study.worst_case_constraint
    if not whole or constraint is None or trial.worst_case is None:
        return extended, holds
    values = _values(evaluations, Stage.CHECK_WORST, constraint.metric)
    mean, noise = float(values.mean()), float(values.std(ddof=1))
    # Refuted is what violates by more than the error of the estimate, mean + z noise.
    z = constraint.deviations
    error = noise * float(np.sqrt((1.0 + 0.5 * z**2) / len(values)))
    holds = holds and mean + z * noise - error <= constraint.upper
    holds = (
        holds
        and _values(evaluations, Stage.CHECK_DRAWN, constraint.metric).max() <= constraint.upper
    )
    worst = trial.worst_case
    checked = replace(worst, value=mean, observed=max(worst.observed, float(values.max())))
    return replace(extended, worst_case=checked), bool(holds)


def _values(evaluations: Sequence[Evaluation], stage: Stage, metric: str) -> Array:
    return np.array(
        [
            evaluation.outcome.metrics[metric]
            for evaluation in evaluations
            if evaluation.stage is stage
        ]
    )


def _chance_holds(trial: Trial, constraint: Constraint) -> bool:
    values = np.array(trial.observations(constraint.metric))
    return float(np.mean(values > constraint.upper)) <= constraint.allowed
