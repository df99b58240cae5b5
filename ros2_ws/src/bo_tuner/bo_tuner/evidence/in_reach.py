"""What is in reach where no trial keeps all limits: change the limit, the range or contexts."""

from collections.abc import Collection, Sequence
from math import ceil, isfinite

from bo_tuner.evidence.at_bounds import at_bounds
from bo_tuner.study.constraint import Constraint
from bo_tuner.study.limits import decisive
from bo_tuner.study.study import Study
from bo_tuner.text import shown_beside
from bo_tuner.trials import Trial, TrialState


def in_reach(
    study: Study, trials: Sequence[Trial], violated: Collection[str] = ()
) -> tuple[str, ...]:
    """Return advice in sentences: on each limit that no trial keeps, or else on the hardest one.

    Parameters
    ----------
    study
        The study.
    trials
        All trials of a run in which no parameter set was found feasible.
    violated
        Names of the limits that the recommended one has violated in its validation.
    """
    complete = [trial for trial in trials if trial.state is TrialState.COMPLETE]
    best = {
        name: reached
        for name, constraint in study.constraints.items()
        if (reached := _best(constraint, complete)) is not None
    }
    if not best:
        return ()
    broken = {
        name
        for name, (_, value) in best.items()
        if name in violated or study.constraints[name].violations(value)
    }
    # The one that leaves the least to spare.
    hardest = max(best, key=lambda name: study.constraints[name].excess(best[name][1]))
    chosen = [name for name in best if name in broken] or [hardest]
    sentences = []
    for name in chosen:
        sentences += _of_limit(study, study.constraints[name], *best[name])
    return tuple(sentences)


def _best(constraint: Constraint, trials: Sequence[Trial]) -> tuple[Trial, float] | None:
    """Return the trial with the best value of what a limit is held against; None without any."""
    reached = [
        (trial, value) for trial in trials if isfinite(value := _decisive(constraint, trial))
    ]
    return min(reached, key=lambda pair: constraint.sign * pair[1], default=None)


def _of_limit(study: Study, constraint: Constraint, trial: Trial, value: float) -> list[str]:
    """Say what the best trial reached, and what stands in its way."""
    unit = study.metrics[constraint.metric].unit
    number = f"{shown_beside(value, constraint.limit)} {unit}".rstrip()
    limit = f"{constraint.limit:g} {unit}".rstrip()
    upper = constraint.sign > 0.0
    where = (
        " in the worst context" if constraint.name in trial.worst_cases and study.contexts else ""
    )
    runs = "that runs of a trial keep as often as they must"
    whose = runs if constraint.rule.on_runs else "of any trial"
    title = study.metrics[constraint.metric].title
    sentences = [
        f"In reach: the {'smallest' if upper else 'largest'} {title} {whose}{where} "
        f"is {number} (trial {trial.number}), the limit is {limit}."
    ]
    if bounds := at_bounds(study, trial.parameters):
        names = " and ".join(f"the {b.side} bound of {b.title}" for b in bounds)
        sentences.append(f"That trial is at {names}: widen the range first.")
    elif not constraint.violations(value):
        sentences.append(
            "It keeps this limit by its own few test runs, but no trial is sure enough to keep all "
            "of them: run more trials, or loosen this limit, which leaves the least to spare."
        )
    elif (elsewhere := _elsewhere(constraint, trial)) is not None and study.contexts:
        mean = f"{shown_beside(elsewhere, constraint.limit)} {unit}".rstrip()
        sentences.append(
            f"In the contexts that were drawn at random it is {mean} on average, so the limit is "
            "lost in extreme contexts: narrow them if the machine cannot differ so much, or loosen "
            "the limit."
        )
    else:
        most = "at least" if upper else "at most"
        sentences.append(
            f"Loosen the limit to {most} {number}, with some margin, or tune other parameters."
        )
    return sentences


def _decisive(constraint: Constraint, trial: Trial) -> float:
    """Return what is held against a limit: the worst case, or what enough runs keep; else NaN."""
    if (worst := trial.worst_cases.get(constraint.name)) is not None:
        return decisive(constraint, worst)
    values = sorted(trial.observations(constraint.metric), key=lambda v: constraint.sign * v)
    if not values:
        return float("nan")
    # As many of the runs as must keep the limit have this value or a better one.
    return values[max(ceil(constraint.level * len(values) - 1e-9), 1) - 1]


def _elsewhere(constraint: Constraint, trial: Trial) -> float | None:
    """Return the mean in drawn contexts, if it keeps a limit that the worst context breaks."""
    values = trial.observations(constraint.metric)
    if not constraint.rule.in_every_context or not values:
        return None
    mean = sum(values) / len(values)
    return None if constraint.violations(mean) else mean
