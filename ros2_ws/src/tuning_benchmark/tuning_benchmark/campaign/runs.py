"""One run of a campaign: a row of a table with one seed, with the verdict on its answer."""

import dataclasses
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from bo_tuner.errors import StudyError
from bo_tuner.methods.boundary.method import Boundary
from bo_tuner.methods.protocol import Method
from bo_tuner.methods.recommendation import Recommendation
from bo_tuner.methods.registry import METHODS
from bo_tuner.study.study import Study
from bo_tuner.trials import Evaluation, Trial, TrialState, Value, count_evaluations
from bo_tuner.tuning.driver import Driver
from bo_tuner.tuning.loop import Tuning
from bo_tuner.tuning.observer import NOBODY, RunObserver
from bo_tuner.tuning.summary import choose_answer
from bo_tuner.tuning.validation import ValidationPlan
from tuning_benchmark.campaign.division import divided, further_trials
from tuning_benchmark.campaign.own_contexts import OwnContextsRun
from tuning_benchmark.campaign.timed_backend import TimedBackend
from tuning_benchmark.experiments import plugins
from tuning_benchmark.experiments.experiment import OWN, RANDOM, Row
from tuning_benchmark.judging.neighbours import judge_neighbours
from tuning_benchmark.judging.truth import FEW_REAL_EVALUATIONS, Truth, truth_of, verdict_record
from tuning_benchmark.paper.method import PaperMethod
from tuning_benchmark.paper.reinterpolation_search import OBSERVED
from tuning_benchmark.paper.searches import EachTrial
from tuning_benchmark.peers.adapter import PeerOptimizer, peer_method

MOMENTS = 24
"""Number of moments of a run, at most, at which its incumbent is recorded."""

RANKING = "IV"
"""Method whose ranking is applied to the trials of other optimizers as well."""


@dataclass(frozen=True)
class RunSize:
    """Budget of a run.

    Attributes
    ----------
    evaluations
        The trials end with the one that reaches this number.
    reserved
        Part of it that is kept for a method that checks its candidates.
    initial_trials
        Size of the initial design.
    """

    evaluations: int
    reserved: int
    initial_trials: int


class Run:
    """A row of a table with one seed; iterating over it runs its trials.

    Parameters
    ----------
    study
        The study of the case.
    row
        The algorithm or other optimizer.
    seed
        Seed of the run.
    size
        Its budget.
    method
        In place of the one that the row names.
    window
        Number of trials, or other tasks, that are planned at once.

    Attributes
    ----------
    study
        The study with the seed and the budget of the run.
    method
        The method; for another optimizer one that asks it for parameter sets.
    backend
        Runs the evaluations, and counts them.
    budget
        Evaluations after which the trials end, or are followed by repetitions.
    """

    def __init__(
        self,
        study: Study,
        row: Row,
        seed: int,
        size: RunSize,
        method: Method | None = None,
        *,
        window: int = 1,
    ) -> None:
        whole = _study_of(study, row, seed, size)
        self._peer: PeerOptimizer | None = None
        if row.optimizer:
            self._peer = PeerOptimizer(whole, plugins.load(row.optimizer)(whole, seed))
            method = peer_method(self._peer)
        method = _with_choices(method or METHODS[row.algorithm], row)
        self._evaluations = size.evaluations
        # As many checks as the evaluations allow: what one row spends more, the others lack.
        self.method, self.budget = divided(method, whole, size.evaluations, size.reserved)
        # A method may divide the budget of its trials into parts.
        self.study = whole.replace(evaluations=self.budget)
        self.backend = TimedBackend(self.study)
        self.backend.open()
        self._window = window
        self._tuning = Tuning(self.study, self._driver(), self.method)
        self._recommendation: Recommendation | None = None

    @property
    def trials(self) -> Sequence[Trial]:
        """Trials so far."""
        return self._tuning.trials

    @property
    def done(self) -> bool:
        """Whether the trials have used the budget."""
        return self.backend.evaluations >= self.budget

    def __iter__(self) -> Iterator[Trial]:
        """Run trials until one reaches the budget.

        Then the answer is settled, and where evaluations are left that a method can use, the run is
        continued, as with ``--resume``.
        """
        while True:
            for trial in self._tuning:
                yield trial
                if self.done:
                    break
            if self._peer is not None or not self._settled_early():
                return

    def _settled_early(self) -> bool:
        """Settle the answer; return whether more trials follow, which know what was run for it."""
        settling = _Evaluations()
        left = self._evaluations - self.backend.evaluations
        self._recommendation = choose_answer(
            self.study,
            self._driver(settling),
            self.method,
            self.trials,
            most_repeated=max(0, left),
        )
        left = self._evaluations - self.backend.evaluations
        more = further_trials(self.method, self.study, left)
        if self._recommendation is None or not more:
            return False
        known = self.method.continued(self.trials, settling.evaluations, more=True)
        self.budget = self.backend.evaluations + more
        self.study = self.study.replace(evaluations=count_evaluations(known) + more)
        self._tuning = Tuning(self.study, self._driver(), self.method, trials=known)
        return True

    def _driver(self, observer: RunObserver = NOBODY) -> Driver:
        return Driver(self.backend, observer, window=self._window)

    def incumbent(self) -> int | None:
        """Return the number of the trial believed feasible and best; None if there is none yet."""
        if self._peer is not None:
            return self._peer.recommend()
        return self.first_ranked(self.method)

    def first_ranked(self, method: Method) -> int | None:
        """Return the trial that a method ranks first; None if none is believed feasible."""
        best = method.incumbent(self.study, self.trials)
        return best.trial.number if best is not None and best.believed_feasible else None

    def answer(self) -> tuple[int, bool] | None:
        """Return the trial recommended in the end and whether it is believed feasible, or None.

        A method of the tuner has evaluated its candidates again.
        """
        if self._peer is not None:
            number = self._peer.recommend()
            return None if number is None else (number, True)
        recommendation = self._recommendation
        return (
            None
            if recommendation is None
            else (recommendation.candidate.trial.number, recommendation.feasible)
        )


def _with_choices(method: Method, row: Row) -> Method:
    """Return a method with the choices of a row for stage two."""
    estimate = row.worst_case or (OBSERVED if row.protocol == RANDOM else "")
    if not estimate and row.neighbour_starts is None:
        return method
    search = EachTrial()
    if estimate:
        search = dataclasses.replace(search, estimate=estimate)
    if row.neighbour_starts is not None:
        search = dataclasses.replace(search, neighbour_starts=row.neighbour_starts)
    if not isinstance(method, (PaperMethod, Boundary)):
        raise StudyError(f"{row.name}: {row.algorithm} has no other search for the worst context")
    return dataclasses.replace(method, search=search)


class _Evaluations(RunObserver):
    """Keeps the evaluations while the answer is settled."""

    def __init__(self) -> None:
        self.evaluations: list[Evaluation] = []

    def evaluation(self, evaluation: Evaluation) -> None:
        self.evaluations.append(evaluation)


def run_and_judge(study: Study, row: Row, seed: int, size: RunSize, judge: str) -> dict[str, Any]:
    """Run one row with one seed and judge its answer.

    Returns
    -------
    dict
        What JSON takes. ``trajectory`` has a pair for each moment: evaluations so far and the
        trial believed best then, or None; ``incumbents`` the truth of these trials by number;
        ``ranked``, of another optimizer's run, the trial that `RANKING` would answer; ``cuts`` and
        ``check_cuts`` the evaluations of the trials and of the checks. ``training`` of the answer
        is None where the optimizer chose the contexts. ``seconds`` are processor times.
    """
    run = _run(study, row, seed, size)
    backend = run.backend
    trajectory: list[tuple[int, int | None]] = []
    seconds = 0.0
    begin = time.process_time()
    for _ in run:
        moment = int(backend.evaluations * MOMENTS / run.budget)
        if run.done or not trajectory or moment > int(trajectory[-1][0] * MOMENTS / run.budget):
            seconds += time.process_time() - begin
            trajectory.append((backend.evaluations, run.incumbent()))
            begin = time.process_time()
    seconds += time.process_time() - begin
    evaluation_seconds = backend.seconds
    answer = run.answer()
    trials = run.trials
    used = count_evaluations(trials)
    record: dict[str, Any] = {
        "trials": len(trials),
        "failed_trials": sum(t.state is TrialState.FAILED for t in trials),
        "warnings": sum(len(t.warnings) for t in trials),
        "cuts": used,
        "check_cuts": backend.evaluations - used,
        "trajectory": trajectory,
        "answer": None,
        "ranked": None,
    }
    truth = truth_of(study, judge)
    if row.optimizer and isinstance(run, Run):
        number = run.first_ranked(METHODS[RANKING])
        if number is not None:
            verdict = truth.verdict(trials[number].parameters)
            record["ranked"] = {"trial": number, "truth": verdict_record(verdict)}
    if answer is not None:
        number, believed = answer
        trajectory.append((backend.evaluations, number if believed else None))
        record["answer"] = {
            "trial": number,
            "believed": believed,
            "training": _training(run.study, trials[number]) if isinstance(run, Run) else None,
            **_judged(run, truth, trials[number].parameters),
        }
    record["incumbents"] = {
        str(number): verdict_record(truth.verdict(trials[number].parameters, FEW_REAL_EVALUATIONS))
        for number in sorted({n for _, n in trajectory if n is not None})
    }
    record["seconds"] = {
        "optimizer": round(seconds - evaluation_seconds, 3),
        "cuts": round(evaluation_seconds, 3),
    }
    return record


def _run(study: Study, row: Row, seed: int, size: RunSize) -> Run | OwnContextsRun:
    if row.algorithm or row.protocol != OWN:
        return Run(study, row, seed, size)
    whole = _study_of(study, row, seed, size)
    return OwnContextsRun(whole, plugins.load(row.optimizer)(whole, seed), size.evaluations)


def _study_of(study: Study, row: Row, seed: int, size: RunSize) -> Study:
    """Study of one run: its seed, and more trials than its budget suffices for."""
    initial = size.initial_trials
    study = study.replace(
        seed=seed,
        trials=max(size.evaluations, initial),
        initial_trials=initial,
        evaluations=size.evaluations,
    )
    if row.protocol == RANDOM:
        study = study.replace(drawn_contexts=row.contexts, search_evaluations=0)
    if row.algorithm and row.protocol == OWN:
        budget = dataclasses.replace(study.budget, drawn_contexts=None, search_evaluations=None)
        study = dataclasses.replace(study, budget=budget)
    return study


def _training(study: Study, trial: Trial) -> float:
    """Mean of the objective's metric over the evaluations of the tuning, without the checks."""
    return float(np.mean(trial.unchecked.observations(study.objective.metric)))


def _judged(
    run: Run | OwnContextsRun, truth: Truth, parameters: Mapping[str, Value]
) -> dict[str, Any]:
    """Validate and judge the answer of a run, with its neighbourhood."""
    plan = ValidationPlan(run.study, [parameters])
    Driver(run.backend).complete(plan)
    (validation,), (evaluations,) = plan.results, plan.evaluations
    complete = [evaluation.outcome.metrics for evaluation in evaluations]
    values = [metrics[run.study.objective.metric] for metrics in complete if metrics]
    verdict = truth.verdict(parameters)
    return {
        "parameters": dict(parameters),
        "validation": {
            "objective": float(np.mean(values)) if values else None,
            "feasible": validation.feasible,
            "failures": validation.failures,
            "violations": {
                name: sample.violations for name, sample in validation.constraints.items()
            },
        },
        "truth": verdict_record(verdict),
        "neighbours": judge_neighbours(truth, parameters, verdict),
    }
