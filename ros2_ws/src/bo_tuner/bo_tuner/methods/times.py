"""What the trials of a run have taken, and what one more takes by that."""

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from statistics import fmean

from bo_tuner.optimizers.base import DEFAULT, INITIAL, START
from bo_tuner.trials import Trial, count_trials

RECENT = 10
"""Number of latest trials that times are taken from, or the latest half where that is more."""
FEWEST_FOR_A_TREND = 5
"""Number of times from which on their growth is estimated."""
DESIGN_WEIGHT = 3
"""The initial design counts as so many of the proposed trials that it precedes."""
EXPECTED_WEIGHT = 10
"""What is expected of an evaluation counts as so many that were measured in the phase."""


@dataclass(frozen=True)
class TrialTimes:
    """What a trial took: evaluations, their time [s], all other time, and of that the ranking.

    ``known`` is the number of evaluations up to its end, all trials together.
    """

    evaluations: int
    known: int
    evaluating: float
    other: float
    ranking: float
    proposed: bool


class Times:
    """The times of a run, in which whoever watches the run notes what happens.

    Attributes
    ----------
    trials
        What each trial took.
    counted, evaluations
        Trials that count for the budget, and all evaluations.
    repeated
        Evaluations that checked trials before this session, in runs that had ended.
    answering
        Whether the phase is the search for the answer.
    steps, in_phase, measured_in_phase
        Steps and evaluations of the phase, and those of them that are not from the record.
    seconds_in_phase
        What the phase took until its latest evaluation [s].
    """

    def __init__(self) -> None:
        self.trials: list[TrialTimes] = []
        self.counted = self.evaluations = self.repeated = 0
        # Of an evaluation with no search or proposal before it.
        self.plain: deque[float] = deque(maxlen=4 * RECENT)
        self.begin(answering=False)

    def begin(self, *, answering: bool) -> None:
        """Note the beginning of a phase."""
        self.answering = answering
        self.steps = self.in_phase = self.measured_in_phase = 0
        self.seconds_in_phase = 0.0

    def take(self, trial: Trial, other: float, ranking: float) -> None:
        """Note a trial, what it took beside its evaluations [s], and of that the ranking."""
        evaluating = sum(evaluation.seconds for evaluation in trial.evaluations)
        proposed = trial.proposed_as not in (DEFAULT, START, INITIAL)
        count = len(trial.evaluations)
        known = count + (self.trials[-1].known if self.trials else 0)
        self.trials.append(TrialTimes(count, known, evaluating, other, ranking, proposed))
        self.counted += count_trials([trial])

    def latest_half(self) -> list[TrialTimes]:
        """Return the latest half of the trials, or `RECENT` of them."""
        return self.trials[-max(RECENT, len(self.trials) // 2) :]

    def evaluations_of_trial(self) -> float:
        """Return the mean evaluations of a trial to come, by the latest half and the design."""
        proposed = [item.evaluations for item in self.latest_half() if item.proposed]
        designed = [item.evaluations for item in self.trials if not item.proposed]
        weight = DESIGN_WEIGHT if designed else 0
        total = sum(proposed) + (weight * fmean(designed) if designed else 0.0)
        return total / (len(proposed) + weight)

    def recent_evaluation(self) -> float:
        """Return the time [s] of an evaluation in the latest trials."""
        recent = self.trials[-RECENT:]
        return sum(item.evaluating for item in recent) / sum(item.evaluations for item in recent)

    def plain_evaluation(self) -> float:
        """Return the time [s] from one evaluation to the next with no decision between them."""
        return fmean(self.plain) if self.plain else self.recent_evaluation()

    def ranking(self) -> float:
        """Return the mean time [s] of the latest rankings."""
        return fmean(item.ranking for item in self.trials[-RECENT:])

    def ranking_of(self, evaluations: float) -> float:
        """Return the time [s] of a ranking by so many evaluations, on a line through the latest."""
        ranked = [(item.known, item.ranking) for item in self.latest_half() if item.ranking > 0.0]
        if not ranked:
            return 0.0
        middle, mean, slope = _line(ranked)
        # Between constant and proportional, also where the load changed.
        return mean + min(slope, mean / middle) * (evaluations - middle)

    def beside_evaluations(self, count: int) -> float:
        """Return the mean time [s] beside the evaluations of so many trials to come."""
        proposed = [(k, item.other) for k, item in enumerate(self.trials) if item.proposed]
        if not proposed:
            # A proposal fits the models of a ranking.
            return fmean(item.other for item in self.trials[-RECENT:]) + self.ranking()
        latest = proposed[-max(RECENT, len(proposed) // 2) :]
        middle, mean, slope = _line(latest)
        return mean + slope * (len(self.trials) + 0.5 * (count - 1) - middle)

    def rankings_of_trial(self, expected: float, weight: int) -> float:
        """Return what a trial to come takes beside its evaluations, in rankings.

        What is `expected` counts as so many trials, by its `weight`, that were measured.
        """
        recent = self.trials[-RECENT:]
        measured = [item for item in recent if item.proposed and item.ranking > 0.0]
        total = weight * expected + sum(item.other / item.ranking for item in measured)
        return total / (weight + len(measured))

    def measured(self, expected: float) -> float:
        """Return the time [s] of an evaluation of the phase, by what was expected and measured."""
        passed = EXPECTED_WEIGHT * expected + self.seconds_in_phase
        return passed / (EXPECTED_WEIGHT + self.measured_in_phase)


def _line(points: Sequence[tuple[float, float]]) -> tuple[float, float, float]:
    """Return the centre of some points, and the slope of the straight line through them.

    It is 0 where the line falls, or for too few points.
    """
    middle, mean = (fmean(values) for values in zip(*points, strict=True))
    spread = sum((x - middle) ** 2 for x, _ in points)
    if len(points) < FEWEST_FOR_A_TREND or spread == 0.0:
        return middle, mean, 0.0
    return middle, mean, max(sum((x - middle) * (y - mean) for x, y in points) / spread, 0.0)
