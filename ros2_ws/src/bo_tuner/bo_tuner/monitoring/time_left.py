"""The time that a run will still take, estimated from what its trials have taken.

A trial to come takes as many evaluations as the latest half of the trials, or as a point at the
boundary of `boundary`, each as long as of late, and what a trial takes beside them by the clock:
the proposal, the search for the worst context and the ranking. That grows with the data. Where the
models pool all evaluations it is counted in rankings, whose time follows a straight line over the
evaluations; else that of the proposals does over the trials.

After the trials come the check of candidates, or the repetitions of `boundary`, and the validation,
whose evaluations have no search between them, with rankings between the steps of the check. All of
it follows the clock, so that a change of the load shows within some trials; a pause does not count.
"""

from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from statistics import fmean

from bo_tuner.optimizers.algorithms import Algorithm
from bo_tuner.optimizers.base import DEFAULT, INITIAL, START
from bo_tuner.optimizers.boundary import evaluations_ahead
from bo_tuner.study.study import Study
from bo_tuner.trials import Evaluation, Stage, Trial, count_checks, count_trials
from bo_tuner.tuning.observer import Phase
from bo_tuner.tuning.recommendation import most_check_evaluations
from bo_tuner.tuning.settling import most_repetitions

RECENT = 10
"""Number of latest trials that times are taken from, or the latest half where that is more."""
FEWEST_FOR_A_TREND = 5
"""Number of times from which on their growth is estimated."""
DESIGN_WEIGHT = 3
"""The initial design counts as so many of the proposed trials that it precedes."""
CANDIDATES = 2
"""Candidates that are checked, as if every other one passed."""
MOST_TO_SETTLE = 25
"""It is settled what the answer is after so many repetitions, or when all are used up.

How many it takes differs widely between runs, and hardly depends on how many are allowed.
"""
RANKINGS, RANKINGS_WEIGHT = 5.0, 3
"""What is expected of a trial beside its evaluations, in rankings, where models pool evaluations.

A proposal, which fits the models, ranks and searches, takes all of them but the one after the
trial. The expected value counts as so many trials that were measured.
"""
EXPECTED_WEIGHT = 10
"""What is expected of an evaluation counts as so many that were measured in the phase."""


@dataclass(frozen=True)
class _Times:
    """What a trial took: evaluations, their time [s], all other time, and of that the ranking.

    ``known`` is the number of evaluations up to its end, all trials together.
    """

    evaluations: int
    known: int
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

    def __init__(self, study: Study, algorithm: Algorithm, clock: Callable[[], float]) -> None:
        self._study = study
        self._algorithm = algorithm
        self._clock = clock
        self._trials: list[_Times] = []
        self._counted = self._evaluations = 0
        # Before this session, by runs that had ended.
        self._repeated = 0
        # Of an evaluation with no search or proposal before it.
        self._plain: deque[float] = deque(maxlen=4 * RECENT)
        self.begin("")

    def begin(self, phase: str) -> None:
        """Note the beginning of a phase."""
        self._phase = phase
        self._began = self._trial_began = self._latest = self._clock()
        self._in_phase = self._measured_in_phase = self._steps = 0

    def recall(self, trials: Sequence[Trial]) -> None:
        """Take trials on record, which tell the times of their proposals and evaluations only."""
        self._repeated += count_checks(trials)
        for trial in (checked.unchecked for checked in trials):
            self._evaluations += len(trial.evaluations)
            ranking = trial.seconds / (RANKINGS - 1.0) if self._algorithm.models.pooled else 0.0
            self._take(trial, trial.seconds + ranking, ranking)
        self.begin(self._phase)

    def evaluation(self, evaluation: Evaluation) -> None:
        """Note an evaluation."""
        now = self._clock()
        if self._phase == Phase.TUNING and evaluation.index and evaluation.stage != Stage.SEARCH:
            self._plain.append(max(evaluation.seconds, now - self._latest))
        self._latest = now
        self._evaluations += 1
        self._in_phase += 1
        # One on record takes no time.
        self._measured_in_phase += not evaluation.recorded

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
        if self._phase == Phase.VALIDATION:
            return max(0, draws - self._in_phase) * self._measured(self._plain_evaluation())
        pooled = self._algorithm.models.pooled
        seconds = self._until_settled() if pooled else self._until_checked()
        return seconds + draws * self._plain_evaluation()

    def _take(self, trial: Trial, other: float, ranking: float) -> None:
        evaluating = sum(evaluation.seconds for evaluation in trial.evaluations)
        proposed = trial.proposed_as not in (DEFAULT, START, INITIAL)
        count = len(trial.evaluations)
        known = count + (self._trials[-1].known if self._trials else 0)
        self._trials.append(_Times(count, known, evaluating, other, ranking, proposed))
        self._counted += count_trials([trial])

    def _until_settled(self) -> float:
        """Return the time [s] until the repetitions end, where models pool all evaluations."""
        trials, evaluations = self._counted, float(self._evaluations)
        repeated, seconds = 0, 0.0
        if self._phase == Phase.CHECKING:
            repeated = self._in_phase
            evaluations -= repeated
        else:
            each = self._evaluations_of_trial()
            for count in evaluations_ahead(self._study, trials, evaluations, each):
                evaluations += count
                seconds += count * self._recent_evaluation()
                seconds += self._rankings_of_trial() * self._ranking_of(evaluations)
        most = most_repetitions(self._study, round(evaluations), self._repeated)
        total = repeated + min(max(0, most - repeated), MOST_TO_SETTLE)
        # Most are runs of their own of what may be the answer, and a ranking follows each of them.
        rankings = total - repeated + 1
        seconds += (total - repeated) * self._plain_evaluation()
        return seconds + rankings * self._ranking_of(evaluations + 0.5 * (repeated + total))

    def _until_checked(self) -> float:
        """Return the time [s] until the candidates are checked."""
        size = most_check_evaluations(self._study)
        cost = self._plain_evaluation() + self._ranking() / size
        if self._phase == Phase.CHECKING:
            count = min(self._steps + CANDIDATES, self._algorithm.most_checked)
            return max(0, size * count - self._in_phase) * self._measured(cost)
        trials = self._study.budget.remaining(self._counted, self._evaluations)
        seconds = self._evaluations_of_trial() * self._recent_evaluation()
        seconds += self._beside_evaluations(trials)
        return trials * seconds + min(CANDIDATES, self._algorithm.most_checked) * size * cost

    def _latest_half(self) -> list[_Times]:
        return self._trials[-max(RECENT, len(self._trials) // 2) :]

    def _evaluations_of_trial(self) -> float:
        """Return the mean evaluations of a trial to come that is not one at the boundary."""
        proposed = [item.evaluations for item in self._latest_half() if item.proposed]
        designed = [item.evaluations for item in self._trials if not item.proposed]
        weight = DESIGN_WEIGHT if designed else 0
        total = sum(proposed) + (weight * fmean(designed) if designed else 0.0)
        return total / (len(proposed) + weight)

    def _recent_evaluation(self) -> float:
        """Return the time [s] of an evaluation in the latest trials."""
        recent = self._trials[-RECENT:]
        return sum(item.evaluating for item in recent) / sum(item.evaluations for item in recent)

    def _plain_evaluation(self) -> float:
        """Return the time [s] from one evaluation to the next with no decision between them."""
        return fmean(self._plain) if self._plain else self._recent_evaluation()

    def _ranking(self) -> float:
        return fmean(item.ranking for item in self._trials[-RECENT:])

    def _ranking_of(self, evaluations: float) -> float:
        """Return the time [s] of a ranking by so many evaluations."""
        ranked = [(item.known, item.ranking) for item in self._latest_half() if item.ranking > 0.0]
        if not ranked:
            return 0.0
        middle, mean, slope = _line(ranked)
        # Between constant and proportional, also where the load changed.
        return mean + min(slope, mean / middle) * (evaluations - middle)

    def _rankings_of_trial(self) -> float:
        """Return what a trial to come takes beside its evaluations, in rankings."""
        recent = self._trials[-RECENT:]
        measured = [item for item in recent if item.proposed and item.ranking > 0.0]
        total = RANKINGS_WEIGHT * RANKINGS + sum(item.other / item.ranking for item in measured)
        return total / (RANKINGS_WEIGHT + len(measured))

    def _beside_evaluations(self, count: int) -> float:
        """Return the mean time [s] beside the evaluations of so many trials to come."""
        proposed = [(k, item.other) for k, item in enumerate(self._trials) if item.proposed]
        if not proposed:
            # A proposal fits the models of a ranking.
            return fmean(item.other for item in self._trials[-RECENT:]) + self._ranking()
        latest = proposed[-max(RECENT, len(proposed) // 2) :]
        middle, mean, slope = _line(latest)
        return mean + slope * (len(self._trials) + 0.5 * (count - 1) - middle)

    def _measured(self, expected: float) -> float:
        """Return the time [s] of an evaluation of the phase, by what was expected and measured."""
        # In a pause the marks count from there backwards.
        passed = abs(self._latest - self._began)
        return (EXPECTED_WEIGHT * expected + passed) / (EXPECTED_WEIGHT + self._measured_in_phase)


def _line(points: Sequence[tuple[float, float]]) -> tuple[float, float, float]:
    """Return the centre of some points, and the slope of the straight line through them.

    It is 0 where the line falls, or for too few points.
    """
    middle, mean = (fmean(values) for values in zip(*points, strict=True))
    spread = sum((x - middle) ** 2 for x, _ in points)
    if len(points) < FEWEST_FOR_A_TREND or spread == 0.0:
        return middle, mean, 0.0
    return middle, mean, max(sum((x - middle) * (y - mean) for x, y in points) / spread, 0.0)
