"""The verdict of a run by its validation, and that of a run without a result."""

from collections.abc import Mapping, Sequence

from bo_tuner.optimizers.algorithms import ALGORITHMS
from bo_tuner.study.constraint import EXPECTATION, WORST_CASE
from bo_tuner.study.study import Study
from bo_tuner.text import shown
from bo_tuner.trials import (
    DEFAULT,
    SEEKING_WORST,
    TUNED,
    Evaluation,
    Trial,
    TrialState,
    Value,
    count_evaluations,
    evaluations_of,
)
from bo_tuner.tuning.front import RULE
from bo_tuner.tuning.limits import Sample, worst_case_holds
from bo_tuner.tuning.validation import Validation
from bo_tuner.verdict.observed import Observed
from bo_tuner.verdict.quantities import quantities
from bo_tuner.verdict.verdict import State, Verdict

FAILURES = "failed evaluations"
"""Stands for them where problems have the names of constraints, which have no space."""


def open_verdict(study: Study, trials: Sequence[Trial]) -> Verdict:
    """Return the verdict of a run that has no result, or none yet."""
    done, planned = len(trials), study.budget.trials
    spent = study.budget.is_spent(done, count_evaluations(trials))
    failed = sum(trial.state is TrialState.FAILED for trial in trials)
    if spent and failed == done:
        why = {trial.reason for trial in trials}
        common = f": {why.pop()}" if len(why) == 1 else ""
        reasons = (f"All {failed} trials failed{common}",)
        return Verdict(state=State.INFEASIBLE, trial=None, evidence="", reasons=reasons)
    evidence = f"{done} of {planned} trials"
    if spent:
        evidence = f"all {done} trials are done but not validated"
    return Verdict(state=State.OPEN, trial=None, evidence=evidence)


def validated(
    study: Study,
    trial: int,
    default: Validation,
    tuned: Validation,
    trials: Sequence[Trial],
    evaluations: Sequence[Evaluation],
    *,
    doubt: str,
    measured: bool,
    outliers: Sequence[int] = (),
) -> Verdict:
    """Return the verdict of a run by its validation.

    Parameters
    ----------
    study
        The study.
    trial
        Number of the recommended trial.
    default, tuned
        Validation of the hand-tuned parameter set and of the recommended one.
    trials, evaluations
        All that are on record.
    doubt
        Why the algorithm does not vouch for the recommended trial, see `doubt`; empty if it does.
    measured
        Whether metrics of time are measured, on nodes, and not modelled.
    outliers
        As in `Verdict`.
    """
    problems = _problems(study, tuned, evaluations)
    reasons = (*([doubt] if doubt else []), *problems.values())
    same = is_default(study, tuned.parameters)
    of_default = _found_by_search(study, trials) | _problems(study, default, evaluations)
    observed_sides = (
        observed(evaluations, DEFAULT, default.parameters, default.draws),
        observed(evaluations, TUNED, tuned.parameters, tuned.draws),
    )
    return Verdict(
        state=State.INFEASIBLE if reasons else State.VALIDATED,
        trial=trial,
        evidence=f"the same {fresh_draws(study, tuned.draws)}",
        reasons=reasons,
        default_reasons=reasons if same else tuple(of_default.values()),
        quantities=quantities(
            study,
            *observed_sides,
            {name: name not in problems for name in tuned.constraints},
            {
                name: f"{sample.violations} of {sample.count} draws "
                f"{study.constraints[name].beyond} the limit"
                for name, sample in tuned.constraints.items()
            },
        ),
        choice="" if doubt else _choice(study),
        remarks=(
            *(_load(study, tuned) if measured else ()),
            *_lost(evaluations, tuned.parameters),
        ),
        observed=observed_sides,
        is_default=same,
        outliers=tuple(outliers),
    )


def is_default(study: Study, parameters: Mapping[str, Value]) -> bool:
    """Return whether a parameter set is the hand-tuned one."""
    space = study.search_space()
    return space.key(parameters) == space.key(space.defaults)


def fresh_draws(study: Study, count: int) -> str:
    """Return what a number of draws is of, in a few words."""
    return f"{count} fresh draws of {'context and noise' if study.contexts else 'noise'}"


def doubt(algorithm: str, feasibility: float, *, passed: bool) -> str:
    """Return why an algorithm does not vouch for the trial that it recommends; empty if it does.

    Parameters
    ----------
    algorithm
        Key of `ALGORITHMS`.
    feasibility
        Probability that the trial keeps all limits, by the algorithm's models.
    passed
        Whether it passed the check of candidates; if the algorithm has none, whether it is believed
        feasible.
    """
    if passed:
        return ""
    if ALGORITHMS[algorithm].models.pooled:
        return (
            "By the model of all evaluations it keeps its limits with a probability of only "
            f"{feasibility:.3g}, which is too low"
        )
    return "It did not pass the check of the best candidates"


def observed(
    evaluations: Sequence[Evaluation], side: str, parameters: Mapping[str, Value], draws: int
) -> Observed:
    """Return what a run has on record of a parameter set.

    Parameters
    ----------
    evaluations
        All evaluations on record.
    side
        `DEFAULT` or `TUNED`.
    parameters
        The parameter set. A run that was extended may have validated another one before.
    draws
        Number of draws of its validation.
    """
    drawn: dict[int, Mapping[str, float]] = {}
    others = []
    for evaluation in evaluations_of(evaluations, parameters):
        if not evaluation.outcome.complete:
            continue
        if evaluation.whose == side:
            drawn[evaluation.index] = evaluation.outcome.metrics
        else:
            others.append(evaluation.outcome.metrics)
    return Observed(drawn, draws, others)


def _problems(study: Study, found: Validation, evaluations: Sequence[Evaluation]) -> dict[str, str]:
    """Return why a parameter set is not feasible in the validation, by the name of the constraint.

    Where nobody searched for its worst context, as for the result of an algorithm with nominal
    evaluations alone, a draw beyond a worst-case limit that does not refute it counts, too: nothing
    else speaks for it. Without contexts there is none to search for.
    """
    searched = not study.contexts or _searched(evaluations, found.parameters)
    problems = {}
    for name, sample in found.constraints.items():
        constraint = study.constraints[name]
        if not sample.holds:
            problems[name] = _broken(study, sample)
        elif not searched and sample.violations and constraint.kind == WORST_CASE:
            problems[name] = f"{_broken(study, sample)} (no search was made for its worst context)"
    if found.failures:
        problems[FAILURES] = f"{found.failures} of {found.draws} evaluations failed"
    return problems


def _found_by_search(study: Study, trials: Sequence[Trial]) -> dict[str, str]:
    """Return the worst-case limits that the default breaks where the search of a trial found it."""
    problems = {}
    for trial in trials:
        for constraint in study.worst_case_constraints:
            worst = trial.worst_cases.get(constraint.name)
            if (
                worst is not None
                and is_default(study, trial.parameters)
                and not worst_case_holds(constraint, worst)
            ):
                unit = study.metrics[constraint.metric].unit
                problems[constraint.name] = (
                    f"{constraint.name}: worst case {shown(worst.value)} {unit}".rstrip()
                    + f" in trial {trial.number}, limit {constraint.limit:g}"
                )
    return problems


def _searched(evaluations: Sequence[Evaluation], parameters: Mapping[str, Value]) -> bool:
    """Return whether the worst context of a parameter set was searched."""
    of_set = evaluations_of(evaluations, parameters)
    return any(evaluation.stage in SEEKING_WORST for evaluation in of_set)


def _broken(study: Study, sample: Sample) -> str:
    if not sample.count:
        return f"{sample.name}: no draw is complete"
    constraint = study.constraints[sample.name]
    limit = f"{constraint.limit:g} {study.metrics[constraint.metric].unit}".rstrip()
    if constraint.statistic == EXPECTATION and not sample.holds:
        return f"{sample.name}: the mean over the draws is {constraint.beyond} {limit}"
    return f"{sample.name}: {sample.violations} of {sample.count} draws {constraint.beyond} {limit}"


def _choice(study: Study) -> str:
    """Return how the result was chosen among those of several objectives; empty for one."""
    if len(study.objectives) == 1:
        return ""
    names = [objective.metric for objective in study.objectives]
    return (
        f"Of the trade-offs between {', '.join(names[:-1])} and {names[-1]}, the tuned parameter "
        f"set is {RULE}. For another point of the front use validate and then apply with --trial N."
    )


def _lost(evaluations: Sequence[Evaluation], parameters: Mapping[str, Value]) -> tuple[str, ...]:
    """Return a remark if draws of the tuned parameter set tell nothing of it."""
    drawn = {
        evaluation.index: evaluation.outcome.spoilt
        for evaluation in evaluations_of(evaluations, parameters)
        if evaluation.whose == TUNED
    }
    lost = sum(drawn.values())
    if not lost:
        return ()
    return (
        f"{lost} of the draws that failed {'was' if lost == 1 else 'were'} lost with the nodes, "
        "disturbed by others or not prepared: tune --resume runs such draws again.",
    )


def _load(study: Study, tuned: Validation) -> tuple[str, ...]:
    """Return a remark if only measured times exceed their limits, in all draws."""
    samples = [s for s in tuned.constraints.values() if s.violations or not s.holds]
    metrics = [study.metrics[study.constraints[sample.name].metric] for sample in samples]
    if all(sample.holds for sample in samples) or not all(m.measures_time for m in metrics):
        return ()
    names = ", ".join(metric.name for metric in metrics)
    return (f"Only {names} exceeded a limit; other load on this machine can cause this too.",)
