"""When the trials that are left are not worth their evaluations.

A further trial is expected to lower the cost by at most the largest value of the acquisition
function of Eq. 5, the expected improvement times the probabilities that the point is feasible and
neither an outlier nor a crash. So m trials, chosen at once, lower it by at most m times that value
(union bound). A lower cost is of no use if it cannot be told from the present one: the incumbent is
known to the standard error σ/√k of its k evaluations. The advice to stop is given as soon as

    m · max α(x) < σ / √k

holds twice in a row, asked after every fifth trial. Makarova et al. (2022) compare a bound of what
is left to gain with the statistical error of the incumbent, too. They bound it by confidence
intervals; here it comes from the function that chooses the trials, as with Jones et al. (1998), who
end a search once the largest expected improvement is small.

All of it derives from the study and the trials on record, so that a run that was resumed comes to
the same advice.

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

from bo_tuner.models.surrogates import Surrogates
from bo_tuner.numerics.seeds import Stream, generator
from bo_tuner.optimizers.algorithms import Algorithm
from bo_tuner.optimizers.bayesian import AcquisitionSearch, latest_hyperparameters
from bo_tuner.study.study import Study
from bo_tuner.trials import Trial

PERIOD = 5
"""The question costs about as much as a proposal, so it is asked after every fifth trial only."""

IN_A_ROW = 2
"""The models change from trial to trial; a single yes may be chance."""

OWN_STREAM = 2**31 + 1
"""Part of the key of the random draws, where that of a proposal has the trial's number."""


@dataclass(frozen=True)
class Outlook:
    """What further trials promise.

    Attributes
    ----------
    incumbent
        Lowest posterior mean of the cost among the parameter sets believed feasible.
    gain
        Largest value of the acquisition function, in the unit of the cost.
    noise
        Standard error of the incumbent's cost, in the same unit.
    """

    incumbent: float
    gain: float
    noise: float


@dataclass(frozen=True)
class StopAdvice:
    """The advice to stop, in the unit of the objective's metric.

    Attributes
    ----------
    trials
        Number of trials behind it.
    remaining
        Trials that are left of the budget.
    expected_gain
        What they would gain at most.
    noise
        Standard error of the incumbent's objective.
    """

    trials: int
    remaining: int
    expected_gain: float
    noise: float


class StopAdvisor:
    """Tells when to stop; to be asked after each trial, also after those on record.

    Parameters
    ----------
    study
        The study.
    algorithm
        The algorithm of the run. A random search expects nothing, so it gets no advice.

    Attributes
    ----------
    advice
        The advice, from the trial on which it was given first; None before.
    """

    def __init__(self, study: Study, algorithm: Algorithm) -> None:
        self._study = study
        self._algorithm = algorithm
        self._in_a_row = 0
        self.advice: StopAdvice | None = None

    def consider(self, trials: Sequence[Trial]) -> StopAdvice | None:
        """Return the advice if the last of `trials` gives rise to it, else None.

        Parameters
        ----------
        trials
            All trials so far; one more than in the call before.
        """
        budget = self._study.budget
        done, remaining = len(trials), budget.trials - len(trials)
        if self.advice is not None or self._algorithm.random or remaining <= 0:
            return None
        if done < budget.initial_trials or done % PERIOD:
            return None
        found = outlook(self._study, trials, self._algorithm)
        if found is None or remaining * found.gain >= found.noise:
            self._in_a_row = 0
            return None
        self._in_a_row += 1
        if self._in_a_row < IN_A_ROW:
            return None
        cost = found.incumbent + np.array([0.0, -remaining * found.gain, found.noise])
        now, better, worse = self._study.objective.from_cost(cost).tolist()
        self.advice = StopAdvice(done, remaining, abs(better - now), abs(worse - now))
        return self.advice


def outlook(study: Study, trials: Sequence[Trial], algorithm: Algorithm) -> Outlook | None:
    """Estimate what one more trial promises.

    Parameters
    ----------
    study
        The study.
    trials
        All trials so far.
    algorithm
        The algorithm of the run: its models and its acquisition function.

    Returns
    -------
    Outlook or None
        None while nothing is believed feasible, or after numerical trouble.
    """
    rng = generator(study.seed, Stream.ACQUISITION, OWN_STREAM, len(trials))
    start = latest_hyperparameters(trials)
    try:
        surrogates = Surrogates.fit(study, trials, rng=rng, start=start, options=algorithm.models)
        model = surrogates.objective
        if model is None:
            return None
        search = AcquisitionSearch(surrogates, study.search_space(), algorithm.acquisition, rng)
        if search.incumbent is None:
            return None
        found = search.maximise()
    except (ArithmeticError, np.linalg.LinAlgError, ValueError):
        return None
    means = model.predict_mean(model.points)
    row = int(np.flatnonzero(search.feasible)[np.argmin(means[search.feasible])])
    noise = float(np.sqrt(model.noise_variance / model.counts[row]))
    return Outlook(search.incumbent, float(np.exp(found.value)), noise)
