"""The time that a run will still take, estimated from what its trials have taken.

A trial to come takes as many evaluations as the latest half of the trials, or as a point at the
boundary of `boundary`, each as long as of late, and what a trial takes beside them by the clock:
the proposal, the search for the worst context and the ranking. That grows with the data, as a
straight line through the latest half of the proposals. After the trials come the check of
candidates and the validation, whose evaluations have no search between them, with a ranking after
each step of the check. In these phases their own evaluations tell more and more. All of it follows
the clock, so that a change of the load shows within some trials; a pause does not count.
"""

import math
import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from statistics import fmean

from bo_tuner.optimizers.algorithms import Algorithm
from bo_tuner.optimizers.base import DEFAULT, INITIAL, START
from bo_tuner.optimizers.boundary import new_point, searches
from bo_tuner.study.study import Study
from bo_tuner.trials import Evaluation, Stage, Trial
from bo_tuner.tuning.observer import Phase
from bo_tuner.tuning.recommendation import most_check_evaluations
from bo_tuner.tuning.settling import most_repetitions

RECENT = 10
"""Number of latest trials that times are taken from, or the latest half where that is more."""
FEWEST_FOR_A_TREND = 5
"""Number of proposals from which on their growth is estimated."""
DESIGN_WEIGHT = 3
"""The initial design counts as so many of the proposed trials that it precedes."""
CANDIDATES = 2
"""Candidates that are checked, as if every other one passed."""
SETTLED = 1.0 / 3.0
"""Part of the repetitions that are left after which it is settled what the answer is."""
EXPECTED_WEIGHT = 10
"""What is expected of an evaluation counts as so many that were measured in the phase."""


@dataclass(frozen=True)
class _Times:
    """What a trial took: evaluations, their time [s], all other time, and of that the ranking."""

    evaluations: int
    evaluating: float
    other: float
    ranking: float
    proposed: bool


class TimeLeft:
    """Keeps the times of a run; must be told of each step when it has just ended.

    Parameters
    ----------
    study, algorithm
        Of the run.
    clock
        Returns the time [s] from a fixed point on.
    """

    def __init__(
        self, study: Study, algorithm: Algorithm, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._study = study
        self._algorithm = algorithm
        self._clock = clock
        self._trials: list[_Times] = []
        self._evaluations = 0
        # Of an evaluation with no search or proposal before it.
        self._plain: deque[float] = deque(maxlen=4 * RECENT)
        self.begin("")

    def begin(self, phase: str) -> None:
        """Note the beginning of a phase."""
        self._phase = phase
        self._began = self._trial_began = self._latest = self._clock()
        self._in_phase = self._steps = 0

    def recall(self, trials: Sequence[Trial]) -> None:
        """Take trials on record, which tell the times of their proposals and evaluations only."""
        for trial in trials:
            self._evaluations += len(trial.evaluations)
            self._take(trial, trial.seconds, 0.0)
        self.begin(self._phase)

    def evaluation(self, evaluation: Evaluation) -> None:
        """Note an evaluation."""
        now = self._clock()
        if self._phase == Phase.TUNING and evaluation.index and evaluation.stage != Stage.SEARCH:
            self._plain.append(max(evaluation.seconds, now - self._latest))
        self._latest = now
        self._evaluations += 1
        self._in_phase += 1

    def step(self) -> None:
        """Note a step of the phase that is not a trial."""
        self._steps += 1

    def trial(self, trial: Trial) -> None:
        """Note a trial, after its evaluations and the ranking."""
        now = self._clock()
        evaluating = sum(evaluation.seconds for evaluation in trial.evaluations)
        other = max(trial.seconds, now - self._trial_began - evaluating)
        self._take(trial, other, now - self._latest)
        self._trial_began = self._latest = now

    def pause(self) -> None:
        """Note the beginning of a pause, or its end."""
        # In a pause the marks are times so far instead of points in time.
        now = self._clock()
        self._began, self._trial_began, self._latest = (
            now - mark for mark in (self._began, self._trial_began, self._latest)
        )

    def estimate(self) -> float | None:
        """Return the time [s] until the result is there; None before the first trial."""
        if not self._trials:
            return None
        draws = 2 * self._study.budget.validation_draws
        if self._phase == Phase.TUNING:
            trials, evaluations = self._to_come()
            seconds = evaluations * self._recent_evaluation()
            seconds += trials * self._beside_evaluations(trials)
            checks, cost = self._checks(self._evaluations + round(evaluations), 0)
            return seconds + checks * cost + draws * self._plain_evaluation()
        if self._phase == Phase.CHECKING:
            checks, cost = self._checks(self._evaluations - self._in_phase, self._in_phase)
            return checks * self._measured(cost) + draws * self._plain_evaluation()
        return max(0, draws - self._in_phase) * self._measured(self._plain_evaluation())

    def _take(self, trial: Trial, other: float, ranking: float) -> None:
        evaluating = sum(evaluation.seconds for evaluation in trial.evaluations)
        proposed = trial.origin not in (DEFAULT, START, INITIAL)
        self._trials.append(_Times(len(trial.evaluations), evaluating, other, ranking, proposed))

    def _latest_half(self) -> list[_Times]:
        return self._trials[-max(RECENT, len(self._trials) // 2) :]

    def _to_come(self) -> tuple[int, float]:
        """Return how many trials are to come, and how many evaluations in all."""
        budget, known = self._study.budget, len(self._trials)
        proposed = [item.evaluations for item in self._latest_half() if item.proposed]
        designed = [item.evaluations for item in self._trials if not item.proposed]
        weight = DESIGN_WEIGHT if designed else 0
        total = sum(proposed) + (weight * fmean(designed) if designed else 0.0)
        each = total / (len(proposed) + weight)
        if not self._algorithm.models.pooled:
            trials = budget.remaining(known, self._evaluations)
            return trials, trials * each
        trials, evaluations = 0, 0.0
        while True:
            done = known + trials, round(self._evaluations + evaluations)
            if not budget.remaining(*done):
                return trials, evaluations
            evaluations += each if searches(self._study, *done) else sum(new_point(self._study))
            trials += 1

    def _recent_evaluation(self) -> float:
        """Return the time [s] of an evaluation in the latest trials."""
        recent = self._trials[-RECENT:]
        return sum(item.evaluating for item in recent) / sum(item.evaluations for item in recent)

    def _plain_evaluation(self) -> float:
        """Return the time [s] from one evaluation to the next with no decision between them."""
        return fmean(self._plain) if self._plain else self._recent_evaluation()

    def _ranking(self) -> float:
        return fmean(item.ranking for item in self._trials[-RECENT:])

    def _beside_evaluations(self, count: int) -> float:
        """Return the mean time [s] beside the evaluations of so many trials to come."""
        proposed = [(k, item.other) for k, item in enumerate(self._trials) if item.proposed]
        if not proposed:
            # A proposal fits the models of a ranking.
            return fmean(item.other for item in self._trials[-RECENT:]) + self._ranking()
        latest = proposed[-max(RECENT, len(proposed) // 2) :]
        middle, mean = (fmean(values) for values in zip(*latest, strict=True))
        slope = 0.0
        if len(latest) >= FEWEST_FOR_A_TREND:
            spread = sum((k - middle) ** 2 for k, _ in latest)
            slope = sum((k - middle) * (other - mean) for k, other in latest) / spread
        ahead = len(self._trials) + 0.5 * (count - 1) - middle
        return mean + max(slope, 0.0) * ahead

    def _checks(self, evaluations: int, done: int) -> tuple[float, float]:
        """Return the evaluations that are left of the check, and the time [s] of each.

        The check follows trials with so many evaluations; if it has begun, its phase is the present
        one.
        """
        if self._algorithm.models.pooled:
            most = most_repetitions(self._study, evaluations)
            # A ranking follows the first 2 repetitions of a candidate, and each doubling: log2 n
            # in all if they are of one candidate, n / 2 if each candidate has 2 of them.
            rankings = 2.0 * math.sqrt(most)
            cost = self._plain_evaluation() + self._ranking() * rankings / most
            return SETTLED * max(0, most - done), cost
        size = most_check_evaluations(self._study)
        checked = self._steps if self._phase == Phase.CHECKING else 0
        count = min(checked + CANDIDATES, self._algorithm.most_checked)
        return max(0, size * count - done), self._plain_evaluation() + self._ranking() / size

    def _measured(self, expected: float) -> float:
        """Return the time [s] of an evaluation of the phase, by what was expected and measured."""
        passed = self._latest - self._began
        return (EXPECTED_WEIGHT * expected + passed) / (EXPECTED_WEIGHT + self._in_phase)
