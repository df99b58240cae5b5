"""The runs of a row, summed up."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from bo_tuner.study.study import Study
from tuning_benchmark.experiments.experiment import Case, Row
from tuning_benchmark.experiments.task_names import run_task
from tuning_benchmark.pages.statistics import Mean, Share, mean, share

Record = Mapping[str, Any]


@dataclass(frozen=True)
class RowSummary:
    """A row of a table, from all its runs.

    Attributes
    ----------
    row
        The row.
    results
        Results of the runs that ended, by seed; see `campaign.runs.run_and_judge`.
    answers
        Their answers by seed, of those that have one.
    held
        The answers that were believed feasible and held in the validation's draws.
    validated_objectives
        Objectives in the validation by seed, of the answers that have one.
    feasible_objectives
        True objectives of the truly feasible answers by seed.
    failures
        Reasons of the runs that failed.
    validated
        Runs whose answer held in the validation's draws.
    feasible
        Runs whose answer is feasible in truth.
    narrow
        Answers with a neighbour that is much worse.
    validation
        Objective in the validation, over all answers.
    difference
        Objective in the validation less that in the tuning, over all answers.
    objective
        True objective, over the truly feasible answers.
    distance
        Its distance to the grid's optimum [%]; None without one.
    worst
        True worst case, over all answers.
    best
        Lowest validated objective of a validated answer.
    evaluations, check_evaluations
        Evaluations of the trials, and of the checks of candidates.
    most_evaluations
        Both together in the run that took the most.
    """

    row: Row
    results: Mapping[int, Record]
    answers: Mapping[int, Record]
    held: Mapping[int, Record]
    validated_objectives: Mapping[int, float]
    feasible_objectives: Mapping[int, float]
    failures: tuple[str, ...]
    validated: Share
    feasible: Share
    narrow: int
    validation: Mean
    difference: Mean
    objective: Mean
    distance: Mean | None
    worst: Mean
    best: float | None
    evaluations: Mean
    check_evaluations: Mean
    most_evaluations: int


def summarise(
    case: Case, row: Row, done: Mapping[str, Record], optimum: float | None
) -> RowSummary:
    """Sum up a row.

    Parameters
    ----------
    case, row
        The row and where it belongs.
    done
        Records of the campaign by task.
    optimum
        Objective of the grid's optimum.
    """
    records = {s: done[run_task(case.name, row.name, s)] for s in range(1, case.runs + 1)}
    results = {seed: r["result"] for seed, r in records.items() if not r["failed"]}
    answers = {k: r["answer"] for k, r in results.items() if r["answer"] is not None}
    held = {k: a for k, a in answers.items() if a["believed"] and a["validation"]["feasible"]}
    validated = {
        k: a["validation"]["objective"]
        for k, a in answers.items()
        if a["validation"]["objective"] is not None
    }
    feasible = {k: a["truth"]["objective"] for k, a in answers.items() if a["truth"]["feasible"]}
    sign = case.study.objective.sign
    objectives = [a["validation"]["objective"] for a in held.values()]
    return RowSummary(
        row=row,
        results=results,
        answers=answers,
        held=held,
        validated_objectives=validated,
        feasible_objectives=feasible,
        failures=tuple(r["failed"] for r in records.values() if r["failed"]),
        validated=share(len(held), case.runs),
        feasible=share(len(feasible), case.runs),
        narrow=sum(is_narrow(case.study, a["neighbours"]) for a in answers.values()),
        validation=mean(list(validated.values())),
        difference=mean([E - answers[k]["training"] for k, E in validated.items()]),
        objective=mean(list(feasible.values())),
        distance=None
        if optimum is None
        else mean([100.0 * sign * (E / optimum - 1.0) for E in feasible.values()]),
        worst=mean([w for a in answers.values() if (w := a["truth"]["worst"]) is not None]),
        best=None if not objectives else min(objectives, key=lambda E: sign * E),
        evaluations=mean([result["cuts"] for result in results.values()]),
        check_evaluations=mean([result["check_cuts"] for result in results.values()]),
        most_evaluations=max((r["cuts"] + r["check_cuts"] for r in results.values()), default=0),
    )


def is_narrow(study: Study, neighbours: Sequence[Record]) -> bool:
    """Whether a step of an integer is not tolerable; of any parameter if there are no integers.

    Where a limit is active, a step of a real parameter exceeds it by an amount that depends on the
    arbitrary length of the step; an integer's step has no such choice.
    """
    space = study.search_space()
    integers = {name for name, integer in zip(space.names, space.integer, strict=True) if integer}
    judged = [n for n in neighbours if not integers or integers.intersection(n["changed"])]
    return not all(neighbour["tolerable"] for neighbour in judged)


def incumbent_at(result: Record, evaluations: int) -> Record | None:
    """Truth of the incumbent after so many evaluations; None if there was none yet."""
    number = None
    for used, trial in result["trajectory"]:
        if used > evaluations:
            break
        number = trial
    found: Record | None = None if number is None else result["incumbents"][str(number)]
    return found


def feasible_at(results: Iterable[Record], evaluations: int) -> list[float]:
    """Return the true objectives of the truly feasible incumbents after so many evaluations."""
    found = [incumbent_at(result, evaluations) for result in results]
    return [item["objective"] for item in found if item is not None and item["feasible"]]
