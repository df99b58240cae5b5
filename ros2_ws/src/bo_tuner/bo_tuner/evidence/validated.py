"""The verdict of a run by its validation, and that of a run without a result."""

from collections.abc import Mapping, Sequence

from bo_tuner.evidence.at_bounds import at_bounds
from bo_tuner.evidence.busy import by_the_clock
from bo_tuner.evidence.facts import (
    AgainstLimit,
    AllTrialsFailed,
    Basis,
    Doubt,
    Fact,
    OnlyTimesOver,
    Progress,
    RunsFailed,
    RunsLost,
    RunsToRepeat,
    Said,
    WorstCaseOver,
)
from bo_tuner.evidence.infeasible import Infeasible, infeasible
from bo_tuner.evidence.limit_verdict import LimitVerdict, by_test_runs
from bo_tuner.evidence.observed import Observed
from bo_tuner.evidence.quantities import quantities
from bo_tuner.evidence.verdict import State, Verdict
from bo_tuner.study.limits import Standing, kept_by, worst_case_holds
from bo_tuner.study.study import Study
from bo_tuner.text import capitalized
from bo_tuner.trials import (
    DEFAULT,
    SEEKING_WORST,
    TUNED,
    Context,
    Evaluation,
    Trial,
    TrialState,
    Value,
    count_evaluations,
    count_trials,
    evaluations_of,
)
from bo_tuner.tuning.prospects import Prospects
from bo_tuner.tuning.validation import Validation

FAILURES = "failed test runs"
"""Stands for them where problems have the names of constraints, which have no space."""


def open_verdict(study: Study, trials: Sequence[Trial], standstill: str = "") -> Verdict:
    """Return the verdict of a run that has no result, or none yet."""
    if standstill and not kept_by(study, trials):
        return Verdict(
            state=State.INFEASIBLE,
            trial=None,
            reasons=(Said(capitalized(standstill)),),
            standstill=True,
            infeasible=infeasible(study, trials),
        )
    done, planned = count_trials(trials), study.budget.trials
    spent = study.budget.is_spent(done, count_evaluations(trials))
    if spent and all(trial.state is not TrialState.COMPLETE for trial in trials):
        why = {trial.reason for trial in trials}
        failed = AllTrialsFailed(len(trials), why.pop() if len(why) == 1 else "")
        return Verdict(
            state=State.INFEASIBLE,
            trial=None,
            reasons=(failed,),
            infeasible=infeasible(study, trials),
        )
    return Verdict(state=State.OPEN, trial=None, basis=Progress(done, planned, spent))


def validated(
    study: Study,
    trial: int,
    default: Validation,
    tuned: Validation,
    trials: Sequence[Trial],
    evaluations: Sequence[Evaluation],
    *,
    doubt: str,
    likely: bool = False,
    outliers: Sequence[int] = (),
    prospects: Prospects | None = None,
) -> Verdict:
    """Return the verdict of a run by its validation."""
    limits, default_limits = (limits_in(study, side, evaluations) for side in (tuned, default))
    problems = _problems(tuned, limits)
    reasons: tuple[Fact, ...] = (*([Doubt(doubt)] if doubt else []), *problems.values())
    lost = _lost(tuned, evaluations)
    state = State.INFEASIBLE if reasons else State.INCOMPLETE if lost else State.VALIDATED
    if doubt and likely and not problems:
        state = State.UNPROVEN
    same = is_default(study, tuned.parameters)
    of_default = _found_by_search(study, trials) | _problems(default, default_limits)
    known = default.draws > 0 and not default.lost
    default_reasons = tuple(of_default.values()) if of_default or known else None
    if same:
        default_reasons = None if lost and not reasons else reasons
    sides = (
        observed(evaluations, DEFAULT, default.parameters, default.draws),
        observed(evaluations, TUNED, tuned.parameters, tuned.draws),
    )
    return Verdict(
        state=state,
        trial=trial,
        basis=Basis(tuned.draws),
        reasons=(lost,) if lost is not None and state is State.INCOMPLETE else reasons,
        default_reasons=default_reasons,
        quantities=quantities(study, *sides, default_limits, limits, {}),
        trade_offs=() if doubt else _trade_offs(study),
        remarks=(
            *_load(study, tuned, evaluations),
            *((RunsToRepeat(),) if tuned.lost + default.lost else ()),
        ),
        observed=sides,
        is_default=same,
        outliers=tuple(outliers),
        # Around a set that is not feasible wider bounds promise nothing.
        at_bounds=() if state is State.INFEASIBLE else at_bounds(study, tuned.parameters),
        infeasible=_infeasible(study, tuned, trials, outliers, prospects)
        if state is State.INFEASIBLE
        else None,
        default_lost=default.lost,
    )


def _infeasible(
    study: Study,
    tuned: Validation,
    trials: Sequence[Trial],
    outliers: Sequence[int],
    prospects: Prospects | None,
) -> Infeasible:
    """Return why none of the trials that were candidates is feasible."""
    samples = tuned.constraints.items()
    refuted = [name for name, sample in samples if sample.count and not sample.agrees]
    candidates = [trial for trial in trials if trial.number not in outliers]
    return infeasible(study, candidates, prospects, refuted, tuned.failures)


def is_default(study: Study, parameters: Mapping[str, Value]) -> bool:
    """Return whether a parameter set is the hand-tuned one."""
    space = study.search_space()
    return space.key(parameters) == space.key(space.defaults)


def observed(
    evaluations: Sequence[Evaluation], side: str, parameters: Mapping[str, Value], draws: int
) -> Observed:
    """Return what a run has on record of a parameter set."""
    drawn: dict[int, Mapping[str, float]] = {}
    contexts: dict[int, Context] = {}
    others = []
    for evaluation in evaluations_of(evaluations, parameters):
        if not evaluation.outcome.complete:
            continue
        if evaluation.whose == side:
            drawn[evaluation.index] = evaluation.outcome.metrics
            contexts[evaluation.index] = evaluation.context
        else:
            others.append(evaluation.outcome.metrics)
    return Observed(drawn, draws, others, contexts=contexts)


def limits_in(
    study: Study, validation: Validation, evaluations: Sequence[Evaluation]
) -> dict[str, LimitVerdict]:
    """Return what the validation of a parameter set says of each limit, by its name."""
    unsearched = bool(study.contexts) and not _searched(evaluations, validation.parameters)
    return {
        name: by_test_runs(study, sample, unsearched=unsearched)
        for name, sample in validation.constraints.items()
    }


def _problems(validation: Validation, limits: Mapping[str, LimitVerdict]) -> dict[str, Fact]:
    """Return what speaks against a parameter set in the validation, by the constraint's name."""
    problems: dict[str, Fact] = {
        name: AgainstLimit(limit)
        for name, limit in limits.items()
        # All of the test runs may have been lost, or none made, which shows nothing.
        if limit.standing is Standing.VIOLATED
        and (limit.runs or (validation.draws and not validation.lost))
    }
    if validation.failures:
        problems[FAILURES] = RunsFailed(validation.failures, validation.draws)
    return problems


def _found_by_search(study: Study, trials: Sequence[Trial]) -> dict[str, Fact]:
    """Return the worst-case limits that the default breaks where the search of a trial found it."""
    problems: dict[str, Fact] = {}
    for trial in trials:
        for constraint in study.worst_case_constraints:
            worst = trial.worst_cases.get(constraint.name)
            if (
                worst is not None
                and is_default(study, trial.parameters)
                and not worst_case_holds(constraint, worst)
            ):
                unit = study.metrics[constraint.metric].unit
                problems[constraint.name] = WorstCaseOver(
                    constraint, study.limit_title(constraint), unit, worst.value, trial.number
                )
    return problems


def _searched(evaluations: Sequence[Evaluation], parameters: Mapping[str, Value]) -> bool:
    """Return whether the worst context of a parameter set was searched."""
    of_set = evaluations_of(evaluations, parameters)
    return any(evaluation.stage in SEEKING_WORST for evaluation in of_set)


def _trade_offs(study: Study) -> tuple[str, ...]:
    """Return the titles of several objectives; none for one."""
    titles = tuple(study.metrics[objective.metric].title for objective in study.objectives)
    return titles if titles[1:] else ()


def _lost(tuned: Validation, evaluations: Sequence[Evaluation]) -> RunsLost | None:
    """Return that test runs of the tuned parameter set are unusable; None if none is."""
    if not tuned.lost:
        return None
    why = {
        evaluation.outcome.reason
        for evaluation in evaluations_of(evaluations, tuned.parameters)
        if evaluation.whose == TUNED and evaluation.outcome.unusable
    }
    return RunsLost(tuned.lost, tuned.draws, why.pop() if len(why) == 1 else "")


def _load(study: Study, tuned: Validation, evaluations: Sequence[Evaluation]) -> tuple[Fact, ...]:
    """Return a fact if only measured times exceed limits, and the nodes' load is not known."""
    runs = [e.outcome for e in evaluations_of(evaluations, tuned.parameters) if e.whose == TUNED]
    complete = [outcome for outcome in runs if outcome.complete]
    times = {name for outcome in complete for name in by_the_clock(study, outcome)}
    samples = [s for s in tuned.constraints.values() if s.violations or not s.agrees]
    exceeding = [study.constraints[sample.name].metric for sample in samples]
    known = any(o.load is not None and o.load.nodes is not None for o in complete)
    if known or all(sample.agrees for sample in samples) or not times.issuperset(exceeding):
        return ()
    return (OnlyTimesOver(tuple(study.metrics[name].title for name in exceeding)),)
