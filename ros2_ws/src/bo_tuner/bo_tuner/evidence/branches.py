"""The best of each branch of a conditional search space, by the trials of a run."""

from collections.abc import Iterator, Sequence
from math import nan

from bo_tuner.evidence.facts import Branch, Branches
from bo_tuner.evidence.trial_row import TrialOutcome, outcome_of
from bo_tuner.study.study import Study
from bo_tuner.trials import Trial


def branches(study: Study, trials: Sequence[Trial]) -> Iterator[Branches]:
    """Yield the best trial within the limits of each branch that was tried, if there are several.

    The best has the lowest mean cost over its own runs.
    """
    space, objective = study.search_space(), study.objective
    by_branch: dict[str, list[Trial]] = {}
    for trial in trials:
        by_branch.setdefault(space.branch(trial.parameters), []).append(trial)
    if len(by_branch) < 2:
        return
    found = []
    for name, tried in by_branch.items():
        means = {
            trial.number: mean
            for trial in tried
            if outcome_of(study, trial) is TrialOutcome.WITHIN
            and (mean := trial.mean(objective.metric)) is not None
        }
        costs = {number: float(objective.to_cost(mean)) for number, mean in means.items()}
        best = min(costs, key=costs.__getitem__, default=None)
        found.append(Branch(name, len(tried), best, nan if best is None else means[best]))
    metric = study.metrics[objective.metric]
    yield Branches(metric.title, metric.unit, tuple(sorted(found, key=lambda each: each.name)))
