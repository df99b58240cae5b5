"""The runs of a row, summed up."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from bo_tuner.study.study import Study
from tuning_benchmark.experiments.experiment import Case, Row
from tuning_benchmark.experiments.optima import Optimum
from tuning_benchmark.experiments.task_names import run_task
from tuning_benchmark.judging.neighbours import deciding
from tuning_benchmark.pages.statistics import Mean, Share, mean, share

Record = Mapping[str, Any]

NEAR = 0.05
"""Relative distance to the optimum that counts as near."""


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
        Its distance to the optimum [%]; None without one.
    regrets
        By seed, distance [%] of the truly feasible answers to the lowest objective at their own
        worst case, so that a larger margin is no fault; of those where the frontier is known.
    kept
        Realized probability by seed: share of runs within the limit in the worst context.
    reached
        By seed, evaluations after which the incumbent was truly feasible and within `NEAR` of the
        optimum for good; infinite if that was never so.
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
    validated: Share
    feasible: Share
    narrow: int
    validation: Mean
    difference: Mean
    objective: Mean
    distance: Mean | None
    regrets: Mapping[int, float]
    kept: Mapping[int, float]
    reached: Mapping[int, float]
    worst: Mean
    best: float | None
    evaluations: Mean
    check_evaluations: Mean
    most_evaluations: int


def summarize(
    case: Case, row: Row, done: Mapping[str, Record], optimum: Optimum | None
) -> RowSummary:
    """Sum up a row.

    Parameters
    ----------
    case, row
        The row and where it belongs.
    done
        Records of the campaign by task.
    optimum
        What is known of the study's optimum.
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
        validated=share(len(held), case.runs),
        feasible=share(len(feasible), case.runs),
        narrow=sum(is_narrow(case.study, a["neighbours"]) for a in answers.values()),
        validation=mean(list(validated.values())),
        difference=mean(
            [
                E - answers[k]["training"]
                for k, E in validated.items()
                if answers[k]["training"] is not None
            ]
        ),
        objective=mean(list(feasible.values())),
        distance=None
        if optimum is None
        else mean([100.0 * sign * (E / optimum.objective - 1.0) for E in feasible.values()]),
        regrets=_regrets(answers, optimum, sign),
        kept={k: a["truth"]["worst_kept"] for k, a in answers.items() if _kept(a) is not None},
        reached={k: _reached(r, optimum, sign) for k, r in results.items()},
        worst=mean([w for a in answers.values() if (w := a["truth"]["worst"]) is not None]),
        best=None if not objectives else min(objectives, key=lambda E: sign * E),
        evaluations=mean([result["cuts"] for result in results.values()]),
        check_evaluations=mean([result["check_cuts"] for result in results.values()]),
        most_evaluations=max((r["cuts"] + r["check_cuts"] for r in results.values()), default=0),
    )


def _regrets(
    answers: Mapping[int, Record], optimum: Optimum | None, sign: float
) -> dict[int, float]:
    regrets = {}
    for seed, answer in answers.items():
        truth = answer["truth"]
        least = optimum.at(truth["worst"]) if optimum and truth["feasible"] else None
        if least is not None:
            regrets[seed] = 100.0 * sign * (truth["objective"] / least - 1.0)
    return regrets


def _kept(answer: Record) -> float | None:
    """Realized probability of an answer; records from before it was judged have none."""
    kept: float | None = answer["truth"].get("worst_kept")
    return kept


def _reached(result: Record, optimum: Optimum | None, sign: float) -> float:
    """Return the evaluations after which the incumbent was near the optimum for good."""
    reached = np.inf
    for used, number in result["trajectory"]:
        truth = None if number is None else result["incumbents"][str(number)]
        near = (
            optimum is not None
            and truth is not None
            and truth["feasible"]
            and sign * (truth["objective"] / optimum.objective - 1.0) <= NEAR
        )
        reached = min(reached, used) if near else np.inf
    return float(reached)


def is_narrow(study: Study, neighbours: Sequence[Record]) -> bool:
    """Whether a step that counts, see `neighbours.deciding`, is not tolerable."""
    return not all(n["tolerable"] for n in neighbours if deciding(study, n["changed"]))


def incumbent_at(result: Record, evaluations: int) -> Record | None:
    """Truth of the incumbent after so many evaluations; None if there was none yet."""
    number = None
    for used, trial in result["trajectory"]:
        if used > evaluations:
            break
        number = trial
    truth: Record | None = None if number is None else result["incumbents"][str(number)]
    return truth


def feasible_at(results: Iterable[Record], evaluations: int) -> list[float]:
    """Return the true objectives of the truly feasible incumbents after so many evaluations."""
    incumbents = [incumbent_at(result, evaluations) for result in results]
    return [item["objective"] for item in incumbents if item is not None and item["feasible"]]
