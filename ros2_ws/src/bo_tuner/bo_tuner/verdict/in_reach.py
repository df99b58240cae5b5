"""What is in reach where no trial keeps all limits, and what to change: limit, range or contexts."""

from collections.abc import Sequence

from bo_tuner.study.constraint import WORST_CASE, Constraint
from bo_tuner.study.limits import violated, uncertain
from bo_tuner.study.study import Study
from bo_tuner.text import shown_beside
from bo_tuner.trials import Trial, TrialState
from bo_tuner.verdict.at_bounds import at_bounds


def in_reach(study: Study, trials: Sequence[Trial]) -> tuple[str, ...]:
    """Return advice in sentences, for each limit that no trial keeps; none without such a limit.

    Parameters
    ----------
    study
        The study.
    trials
        All trials of a run in which no parameter set was found feasible.
    """
    complete = [trial for trial in trials if trial.state is TrialState.COMPLETE]
    if not complete:
        return ()
    broken = [{*violated(study, trial), *uncertain(study, trial)} for trial in complete]
    never = [c for name, c in study.constraints.items() if all(name in names for names in broken)]
    sentences = [line for c in never for line in _of_limit(study, c, complete)]
    if not never and len(study.constraints) > 1 and all(broken):
        fewest = min(range(len(complete)), key=lambda k: len(broken[k]))
        names = " and ".join(sorted(broken[fewest]))
        sentences.append(
            "Each limit alone is kept by a trial, but no trial keeps all of them: loosen one, or "
            f"widen the ranges. Trial {complete[fewest].number} breaks {names} alone."
        )
    return tuple(sentences)


def _of_limit(study: Study, constraint: Constraint, trials: Sequence[Trial]) -> list[str]:
    """Say what the best trial reached, and what stands in its way."""
    reached = {k: v for k, trial in enumerate(trials) if (v := _decisive(constraint, trial)) == v}
    if not reached:
        return []
    best = min(reached, key=lambda k: constraint.sign * reached[k])
    trial, value = trials[best], reached[best]
    unit = study.metrics[constraint.metric].unit
    number = f"{shown_beside(value, constraint.limit)} {unit}".rstrip()
    extreme = "smallest" if constraint.sign > 0.0 else "largest"
    where = " in the worst context" if constraint.name in trial.worst_cases and study.contexts else ""
    limit = f"{constraint.limit:g} {unit}".rstrip()
    found = [
        f"In reach: the {extreme} {constraint.metric} of any trial{where} is {number} (trial "
        f"{trial.number}), the limit is {limit}."
    ]
    if bounds := at_bounds(study, trial.parameters):
        names = " and ".join(f"the {b.side} bound of {b.parameter}" for b in bounds)
        found.append(f"That trial is at {names}: widen the range first.")
    elif (others := _elsewhere(constraint, trial)) is not None and study.contexts:
        elsewhere = f"{shown_beside(others, constraint.limit)} {unit}".rstrip()
        found.append(
            f"In the contexts that were drawn at random it is {elsewhere} on average: the limit is "
            "lost in extreme contexts. Narrow them if the machine cannot differ so much, or loosen "
            "the limit."
        )
    else:
        found.append(
            f"Loosen the limit to at least {number}, with some margin, or tune other parameters."
            if constraint.sign > 0.0
            else f"Loosen the limit to at most {number}, with some margin, or tune other parameters."
        )
    return found


def _decisive(constraint: Constraint, trial: Trial) -> float:
    """Return what is held against a limit: the worst case, or what enough runs keep; else NaN."""
    if (worst := trial.worst_cases.get(constraint.name)) is not None:
        return worst.value + constraint.sign * constraint.deviations * worst.noise
    values = sorted(trial.observations(constraint.metric), key=lambda v: constraint.sign * v)
    if not values:
        return float("nan")
    # The value that as many of the runs keep as must.
    return values[min(len(values) - 1, int(constraint.level * len(values)))]


def _elsewhere(constraint: Constraint, trial: Trial) -> float | None:
    """Return the mean in drawn contexts, if it keeps a limit that the worst context breaks."""
    values = trial.observations(constraint.metric)
    if constraint.kind != WORST_CASE or not values:
        return None
    mean = sum(values) / len(values)
    return None if constraint.violations(mean) else mean
