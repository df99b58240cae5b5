"""One run of a campaign: a row of a table with one seed, from its first cut to its verdict."""

import dataclasses
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from bo_tuner.backends.inprocess import InProcessBackend
from bo_tuner.optimizers.algorithms import ALGORITHMS, Algorithm
from bo_tuner.optimizers.ranking import rank
from bo_tuner.study.study import Study
from bo_tuner.trials import TUNING, Evaluation, Trial, TrialState, Value
from bo_tuner.tuning.loop import Tuning
from bo_tuner.tuning.recommendation import CHECK_EVALUATIONS, recommend
from bo_tuner.tuning.validation import Validation, validate
from bo_tuner.worst_case.search import OBSERVED
from tuning_benchmark import plugins
from tuning_benchmark.asked import AskedAlgorithm, AskedOptimizer
from tuning_benchmark.experiment_parts import RANDOM, Row
from tuning_benchmark.neighbours import judge_neighbours
from tuning_benchmark.optimizer import Optimizer
from tuning_benchmark.truth import FEW_REAL_EVALUATIONS, Truth, truth_of, verdict_record

MOMENTS = 24
"""So many times in a run, at most, its best solution so far is asked for."""


RANKING = "IV"
"""Algorithm whose ranking is applied to the trials of other optimizers as well."""


class TimedBackend:
    """Runs cuts in process, and counts them and their processor time."""

    name = InProcessBackend.name

    def __init__(self, study: Study) -> None:
        self._backend = InProcessBackend(study)
        self.evaluations = 0
        self.seconds = 0.0

    def open(self) -> None:
        """Make the objects."""
        self._backend.open()

    def run(self, evaluations: Iterable[Evaluation]) -> Iterator[Evaluation]:
        """Run planned evaluations."""
        for planned in evaluations:
            begin = time.process_time()
            (evaluation,) = self._backend.run([planned])
            self.seconds += time.process_time() - begin
            self.evaluations += 1
            yield evaluation

    def close(self) -> None:
        """Forget the objects."""
        self._backend.close()


class Contestant:
    """A row of the table in one run: how it proposes, and what it would answer.

    Parameters
    ----------
    row
        The row.
    study
        The study of the run.
    reserved
        Cuts for the checks of an algorithm's candidates.
    """

    def __init__(self, row: Row, study: Study, reserved: int) -> None:
        self._study = study
        self._asked: AskedOptimizer | None = None
        if row.algorithm:
            algorithm = ALGORITHMS[row.algorithm]
        else:
            optimizer: Optimizer = plugins.load(row.optimizer)(study, study.seed)
            self._asked = AskedOptimizer(study, optimizer)
            algorithm = AskedAlgorithm(row.optimizer, asked=self._asked, most_checked=0)
        # As many checks as the cuts allow: what one row spends more, the others lack.
        most_checked = min(algorithm.most_checked, reserved // CHECK_EVALUATIONS)
        changes: dict[str, Any] = {"most_checked": most_checked}
        if row.protocol == RANDOM:
            changes["worst_case"] = OBSERVED
        if row.worst_case:
            changes["worst_case"] = row.worst_case
        if row.neighbour_starts is not None:
            changes["neighbour_starts"] = row.neighbour_starts
        self.algorithm: Algorithm = dataclasses.replace(algorithm, **changes)

    def incumbent(self, trials: Sequence[Trial]) -> int | None:
        """Return the trial believed feasible and best, or None if there is none yet."""
        if self._asked is not None:
            return self._asked.recommend()
        return first_ranked(self._study, trials, self.algorithm)

    def answer(self, backend: TimedBackend, trials: Sequence[Trial]) -> tuple[int, bool] | None:
        """Return the trial recommended in the end and whether it is believed feasible.

        An algorithm of the product checks its candidates by cuts first.
        """
        if self._asked is not None:
            number = self._asked.recommend()
            return None if number is None else (number, True)
        found = recommend(
            self._study,
            backend,
            trials,
            self.algorithm.models,
            most_checked=self.algorithm.most_checked,
        )
        return None if found is None else (found.candidate.trial.number, found.feasible)


def first_ranked(study: Study, trials: Sequence[Trial], algorithm: Algorithm) -> int | None:
    """Return the trial that a method ranks first, without checks; None if none seems feasible."""
    ranked = rank(study, trials, algorithm.models)
    return ranked[0].trial.number if ranked and ranked[0].believed_feasible else None


@dataclass(frozen=True)
class RunSize:
    """Budget of a run.

    Attributes
    ----------
    cuts
        Its trials end with the one that reaches so many.
    reserved
        Of these, left to an algorithm that checks its candidates.
    initial_trials
        Size of the initial design.
    """

    evaluations: int
    reserved: int
    initial_trials: int


def study_of(study: Study, row: Row, seed: int, size: RunSize) -> Study:
    """Study of one run: its seed, and as many trials as its cuts allow."""
    initial = size.initial_trials
    study = study.replace(seed=seed, trials=max(size.evaluations, initial), initial_trials=initial)
    if row.protocol == RANDOM:
        study = study.replace(drawn_contexts=row.contexts, search_evaluations=0)
    return study


def tune(
    study: Study, row: Row, seed: int, size: RunSize
) -> tuple[Study, Contestant, TimedBackend, Tuning, int]:
    """Make a run, ready to go, and tell after how many cuts its trials end."""
    seeded = study_of(study, row, seed, size)
    contestant = Contestant(row, seeded, size.reserved)
    backend = TimedBackend(seeded)
    backend.open()
    tuning = Tuning(seeded, backend, contestant.algorithm)
    reserved = size.reserved if contestant.algorithm.most_checked > 0 else 0
    return seeded, contestant, backend, tuning, size.evaluations - reserved


def run(study: Study, row: Row, seed: int, size: RunSize, judge: str) -> dict[str, Any]:
    """Run one row with one seed and judge it.

    Returns
    -------
    dict
        What JSON takes. ``trajectory`` has a pair for each moment: cuts used so far and the trial
        believed the best then, or None; ``incumbents`` the truth of these trials by number;
        ``ranked``, of another optimizer's run, the trial that `RANKING` would answer. All but
        ``seconds`` is the same on every machine.
    """
    seeded, contestant, backend, tuning, budget = tune(study, row, seed, size)
    trajectory: list[tuple[int, int | None]] = []
    seconds = 0.0
    begin = time.process_time()
    for _ in tuning:
        done = backend.evaluations >= budget
        moment = int(backend.evaluations * MOMENTS / budget)
        if done or not trajectory or moment > int(trajectory[-1][0] * MOMENTS / budget):
            seconds += time.process_time() - begin
            trajectory.append((backend.evaluations, contestant.incumbent(tuning.trials)))
            begin = time.process_time()
        if done:
            break
    seconds += time.process_time() - begin
    used, evaluation_seconds = backend.evaluations, backend.seconds
    answer = contestant.answer(backend, tuning.trials)
    record: dict[str, Any] = {
        "trials": len(tuning.trials),
        "failed_trials": sum(t.state is TrialState.FAILED for t in tuning.trials),
        "warnings": sum(len(t.warnings) for t in tuning.trials),
        "cuts": used,
        "check_cuts": backend.evaluations - used,
        "trajectory": trajectory,
        "answer": None,
        "ranked": None,
    }
    truth = truth_of(study, judge)
    if row.optimizer:
        record["ranked"] = _ranked(seeded, truth, tuning.trials)
    if answer is not None:
        number, believed = answer
        trajectory.append((backend.evaluations, number if believed else None))
        record["answer"] = {
            "trial": number,
            "believed": believed,
            "training": _training(seeded, tuning.trials[number]),
            **_judged(seeded, backend, truth, tuning.trials[number].parameters),
        }
    record["incumbents"] = {
        str(number): verdict_record(
            truth.verdict(tuning.trials[number].parameters, FEW_REAL_EVALUATIONS)
        )
        for number in sorted({n for _, n in trajectory if n is not None})
    }
    record["seconds"] = {
        "optimizer": round(seconds - evaluation_seconds, 3),
        "cuts": round(evaluation_seconds, 3),
    }
    return record


def _ranked(study: Study, truth: Truth, trials: Sequence[Trial]) -> dict[str, Any] | None:
    """Judge what `RANKING` would answer of another optimizer's trials: search apart from choice."""
    number = first_ranked(study, trials, ALGORITHMS[RANKING])
    if number is None:
        return None
    verdict = truth.verdict(trials[number].parameters)
    return {"trial": number, "truth": verdict_record(verdict)}


def _training(study: Study, trial: Trial) -> float:
    """Mean of the objective's metric over the cuts of the tuning alone, without the checks."""
    tuned = dataclasses.replace(
        trial, evaluations=tuple(c for c in trial.evaluations if c.stage in TUNING)
    )
    return float(np.mean(tuned.observations(study.objective.metric)))


def _judged(
    study: Study, backend: TimedBackend, truth: Truth, parameters: Mapping[str, Value]
) -> dict[str, Any]:
    """Validate and judge the answer of a run, with its neighbourhood."""
    (checked,) = validate(study, backend, [parameters])
    verdict = truth.verdict(parameters)
    neighbours = judge_neighbours(truth, parameters, verdict)
    return {
        "parameters": dict(parameters),
        "validation": _validation(checked),
        "truth": verdict_record(verdict),
        "neighbours": neighbours,
    }


def _validation(checked: Validation) -> dict[str, Any]:
    finite = np.isfinite(checked.objective)
    return {
        "objective": checked.objective if finite else None,
        "feasible": checked.feasible,
        "failures": checked.failures,
        "violations": {name: s.violations for name, s in checked.constraints.items()},
    }
