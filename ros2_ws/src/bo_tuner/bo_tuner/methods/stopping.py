"""Advice to stop when the remaining trials are not worth their evaluations.

One more trial is expected to lower the cost by the maximum of the acquisition function α (paper,
Eq. 5), the expected improvement times the probabilities that the point is feasible and neither an
outlier nor a failure. So m trials, chosen at once, are expected to lower it by at most m times that
value (union bound). A gain is not significant if it is smaller than the standard error σ/√k of the
incumbent, where σ is the noise of one evaluation in a drawn context and k their number. The advice
to stop is given if

    m · max α(x) < σ / √k

holds twice in a row; it is computed after every fifth trial. Makarova et al. (2022) also compare
the remaining gain with the statistical error of the incumbent. They bound the gain by confidence
bounds; here it is the one that the acquisition function expects (Jones et al. 1998), who stop once
the largest expected improvement is small. It is no bound: trials chosen one after the other learn
from each other, and the models can be wrong. docs/live.md says what trials gained that the advice
would have spared.

With pooled evaluations (algorithm `boundary`) the incumbent is the parameter set that is shown to
keep its limits, and what counts of a new one is the probability that it will be shown, too. The
noise σ is that of a run in a drawn context, though the model knows what the contexts do: a smaller
gain is one that k runs of the result would not show.

The advice depends only on the study and the recorded trials, so a resumed run gives the same.

References
----------
Jones, Schonlau and Welch (1998). Efficient global optimization of expensive black-box functions.
Journal of Global Optimization 13.
Makarova, Shen, Perrone, Klein, Faddoul, Krause, Seeger and Archambeau (2022). Automatic termination
for hyperparameter optimization. AutoML Conference.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bo_tuner.methods.protocol import Method
from bo_tuner.study.study import Study
from bo_tuner.trials import Trial, count_evaluations, count_trials

PERIOD = 5
"""Number of trials between two computations, each of which costs about as much as a proposal."""

IN_A_ROW = 2
"""Number of times in a row that the inequality must hold; once may be chance."""


@dataclass(frozen=True)
class StopAdvice:
    """The advice to stop, in the unit of the objective's metric.

    Attributes
    ----------
    trials
        Number of trials when the advice was given.
    remaining
        Number of trials that remained of the budget.
    expected_gain
        Gain expected of the remaining trials together.
    noise
        Standard error of the incumbent's objective.
    """

    trials: int
    remaining: int
    expected_gain: float
    noise: float


class StopAdvisor:
    """Decides when to advise stopping; call `consider` after each trial, recorded ones included.

    Parameters
    ----------
    study
        The study.
    method
        The method of the run; there is no advice for random search, or for several objectives.

    Attributes
    ----------
    advice
        The advice once it was given, else None.
    """

    def __init__(self, study: Study, method: Method) -> None:
        self._study = study
        self._method = method
        self._in_a_row = 0
        self.advice: StopAdvice | None = None

    def consider(self, trials: Sequence[Trial]) -> StopAdvice | None:
        """Return the advice if it is given after the last of `trials`, else None.

        Parameters
        ----------
        trials
            All trials so far; one more than in the call before.
        """
        budget = self._study.budget
        done = len(trials)
        remaining = budget.remaining(count_trials(trials), count_evaluations(trials))
        if self.advice is not None or remaining <= 0:
            return None
        # The gain in one scalarization of several objectives says nothing of the others.
        if len(self._study.objectives) > 1:
            return None
        if done < budget.initial_trials or done % PERIOD:
            return None
        outlook = self._method.outlook(self._study, trials)
        if outlook is None or remaining * outlook.gain >= outlook.noise:
            self._in_a_row = 0
            return None
        self._in_a_row += 1
        if self._in_a_row < IN_A_ROW:
            return None
        objective = self._study.objective
        # On a log scale the error towards larger values is the larger one in the metric's unit, so
        # that the gain stays below it in either direction.
        cost = outlook.incumbent + np.array(
            [0.0, -remaining * outlook.gain, objective.sign * outlook.noise]
        )
        now, better, larger = objective.from_cost(cost).tolist()
        self.advice = StopAdvice(done, remaining, abs(better - now), abs(larger - now))
        return self.advice
