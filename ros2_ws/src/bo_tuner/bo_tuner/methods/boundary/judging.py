"""When parameter sets of `boundary` are judged anew, and how sure it must be of their limits."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from bo_tuner.models.constraints import CONFIDENT
from bo_tuner.models.pooled_models import PooledSurrogates
from bo_tuner.optimizers.bayesian import latest_hyperparameters
from bo_tuner.optimizers.ranking import Ranking
from bo_tuner.trials import CHECKS, Trial, pooled


@dataclass(frozen=True)
class PooledRanking(Ranking[PooledSurrogates]):
    """Ranks parameter sets by models of all evaluations, see `required_of`."""

    def sets(self, trials: Sequence[Trial]) -> Sequence[Trial]:
        """Return each parameter set as one trial, its first."""
        return pooled(trials)

    def required(self, trial: Trial) -> float:
        """Return the lowest probability with which a parameter set counts as feasible."""
        return required_of(trial)

    def start(self, trials: Sequence[Trial]) -> Mapping[str, Sequence[float]]:
        """Return the hyperparameters of the latest trial: these are the costliest fits."""
        return latest_hyperparameters(trials)


@dataclass(frozen=True)
class OwnRanking(PooledRanking):
    """Ranks by the machine's own runs, where trials were proposed by models with a simulation."""

    def start(self, trials: Sequence[Trial]) -> Mapping[str, Sequence[float]]:
        """Return nothing: the hyperparameters on record are those of other models."""
        return {}


def judgements(trial: Trial) -> int:
    """Return how often a parameter set was judged anew after it had been run again.

    It is judged whenever the number of its repetitions has doubled, to 2, 4, 8 and so on: judged
    after each run, until it passes, it would pass too often with a limit that is not kept.
    """
    return max(_repetitions(trial).bit_length() - 1, 0)


def runs_until(trial: Trial, judged: int) -> int:
    """Return after how many further runs a trial has been judged anew `judged` times."""
    return int(2**judged) - _repetitions(trial)


def _repetitions(trial: Trial) -> int:
    return sum(evaluation.stage in CHECKS for evaluation in trial.evaluations)


def required_of(trial: Trial) -> float:
    """Return the probability with which a parameter set counts as feasible if runs are pooled.

    What is lacking to 1 is divided by the number of judgements, each as if it were the last: with
    1, 2, 3 of them the shares are 1, 1/2, 1/3. Their sum is not bounded.
    """
    return required_after(judgements(trial))


def required_after(judged: int) -> float:
    """Return `required_of` a parameter set that was judged anew `judged` times."""
    return 1.0 - (1.0 - CONFIDENT) / (1 + judged)
