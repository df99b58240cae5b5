"""What all fits share: points, observations, outliers, and when hyperparameters are fitted.

`pooled_models` says which models these are.
"""

from collections.abc import Callable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from bo_tuner.models.categories import Coding, coded, coded_fit
from bo_tuner.models.censoring import Censored
from bo_tuner.models.context_process import ContextProcess, ContextProcesses
from bo_tuner.models.hyperpriors import Hyperpriors
from bo_tuner.models.nearest_neighbours import NeighbourClassifier
from bo_tuner.models.observations import (
    censored_observations,
    complete_evaluations,
    joint_observations,
)
from bo_tuner.models.protocol import FitModel, Fitted, Model
from bo_tuner.models.student_t import find_outliers
from bo_tuner.numerics.arrays import Array
from bo_tuner.study.constraint import OUTLIERS
from bo_tuner.study.parts import Objective
from bo_tuner.study.study import Study
from bo_tuner.trials import Trial

# Length scale of the classifiers in the unit cube. The objective's length scales do not suit them:
# they are fitted to complete trials only, and are long if the response is flat.
CLASSIFIER_SCALE = 0.25

FITTED_EACH = 100
"""Number of trials up to which the hyperparameters are fitted anew after each of them."""

GROWTH = 0.1
"""Part by which the number of trials grows between fits of the hyperparameters after that.

A fit is most of the time of a proposal then, and one of many trials changes it little. So the
number of fits grows with the logarithm of the trials.
"""


def fitted_after(trials: int) -> bool:
    """Return whether hyperparameters are fitted anew after a number of trials, or kept."""
    if trials <= FITTED_EACH:
        return True
    now, before = (np.log(n / FITTED_EACH) // np.log1p(GROWTH) for n in (trials, trials - 1))
    return bool(now > before)


class Fitting:
    """Fits models of one study's responses to trials, and collects them.

    Parameters
    ----------
    study
        The study.
    trials
        The trials that are fitted to. Their number says whether hyperparameters are fitted anew.
    rng
        Draws starting points of the hyperparameter fits.
    start
        Hyperparameters of an earlier fit, by the names of the models.
    keep
        Whether these are kept, whatever the number of trials.

    Attributes
    ----------
    study, rng
        The study, and the generator of the starting points.
    coding
        Of the parameters' columns.
    minimum : ndarray, shape (d,)
        Lower bounds of the length scales.
    models
        The models fitted so far, by name.
    """

    def __init__(
        self,
        study: Study,
        trials: Sequence[Trial],
        rng: np.random.Generator,
        start: Mapping[str, Sequence[float]] | None,
        *,
        keep: bool = False,
    ) -> None:
        self.study = study
        self.rng = rng
        self._space = study.search_space()
        self.minimum = self._space.minimum_length_scales()
        self.coding = Coding(self._space.levels)
        self._start = start or {}
        self._keep = keep or not fitted_after(len(trials))
        self._cubes: dict[int, Array] = {}
        self.models: dict[str, Fitted] = {}

    def kept(self, name: str) -> Sequence[float] | None:
        """Return the hyperparameters that a model is to keep; None if it is to be fitted."""
        return self._start.get(name) if self._keep else None

    def model(
        self,
        fit: FitModel,
        name: str,
        x: Array,
        y: Array,
        minimum: Array,
        *,
        keep: bool | None = None,
        exact: bool | None = None,
    ) -> Model:
        """Fit the model of a response y (N,) at points x (N, d).

        Parameters
        ----------
        fit
            Fits the model.
        name
            Of the model.
        x, y
            The observations.
        minimum : ndarray, shape (d,)
            Lower bounds of the length scales.
        keep
            Whether the hyperparameters of the start are kept; by default by the number of trials.
        exact
            Whether the observations are free of noise; by default if a run of a parameter set tells
            all, as those in drawn contexts differ by the context.
        """
        if exact is None:
            exact = self.study.a_run_tells_all
        model = coded_fit(fit, self.coding)(
            x,
            y,
            rng=self.rng,
            minimum_length_scales=minimum,
            start=self._start.get(name),
            keep=self._keep if keep is None else keep,
            priors=self._priors(minimum) if exact else None,
        )
        self.models[name] = model
        return model

    def process(
        self,
        processes: ContextProcesses,
        name: str,
        x: Array,
        c: Array,
        y: Array,
        censored: Censored | None = None,
        errors: Array | None = None,
    ) -> ContextProcess:
        """Fit the process of a response y (N,) of parameter sets x (N, d) in contexts c (N, e).

        Of `censored` ones a lower bound is known; `errors` (N,) are known standard errors of y, NaN
        where there is none.
        """
        joint_minimum = np.append(self.minimum, np.zeros(c.shape[1]))
        process = processes.fit(
            x,
            c,
            y,
            coding=self.coding,
            rng=self.rng,
            minimum_length_scales=self.minimum,
            start=self._start.get(name),
            keep=self._keep,
            censored=censored,
            errors=errors,
            priors=self._priors(joint_minimum) if self.study.is_noiseless else None,
        )
        self.models[name] = process
        return process

    def _priors(self, minimum: Array) -> Hyperpriors:
        """Return the priors of exact observations, by lower bounds (d,) of the length scales."""
        return Hyperpriors.noiseless(len(self.coding.spread(minimum)))

    def outliers(self, complete: Sequence[Trial]) -> frozenset[int]:
        """Return the numbers of the complete trials that are outliers of an objective."""
        numbers = self._outliers(complete, self.study.objective, OUTLIERS)
        for further in self.study.further_objectives:
            numbers |= self._outliers(complete, further, f"{OUTLIERS}_{further.metric}")
        return numbers

    def _outliers(
        self, complete: Sequence[Trial], objective: Objective, name: str
    ) -> frozenset[int]:
        x, y, number = self.observations(complete, objective.metric)
        if not len(y):
            # All are from contexts of another distribution.
            return frozenset()
        # On the metric's own scale, where off-the-charts values stand out the most.
        mask, bulk = find_outliers(
            self.coding.encode(x),
            objective.sign * y,
            rng=self.rng,
            minimum_length_scales=self.coding.spread(self.minimum),
            start=self._start.get(name),
            keep=self._keep,
        )
        self.models[name] = coded(bulk, self.coding)
        return frozenset(number[mask].tolist())

    def classifier(
        self, trials: Sequence[Trial], positive: Callable[[Trial], bool]
    ) -> NeighbourClassifier:
        """Return the probability that a trial is positive, by its nearest neighbours."""
        labels = np.array([positive(t) for t in trials], dtype=bool)
        points = self.coding.encode(self.points(trials))
        scales = np.full(points.shape[1], CLASSIFIER_SCALE)
        return NeighbourClassifier(points, labels, scales, encode=self.coding.encode)

    def joint_observations(
        self, trials: Sequence[Trial], metric: str
    ) -> tuple[Array, Array, Array]:
        """Return what `observations.joint_observations` does, by the parameters that were set."""
        contexts = self.study.context_space()
        x, c, y = joint_observations(self.points(trials), contexts, trials, metric)
        for row, evaluation in enumerate(complete_evaluations(trials)):
            if as_set := evaluation.outcome.notes.as_set:
                x[row] = self._space.to_cube({**evaluation.parameters, **as_set})
        return x, c, y

    def censored_observations(self, trials: Sequence[Trial], metric: str) -> Censored:
        """Return what `observations.censored_observations` does."""
        contexts = self.study.context_space()
        return censored_observations(self.points(trials), contexts, trials, metric)

    def points(self, trials: Sequence[Trial]) -> Array:
        """Return the parameter sets (n, d) of trials in the unit cube."""
        for trial in trials:
            if trial.number not in self._cubes:
                self._cubes[trial.number] = self._space.to_cube(trial.parameters)
        rows = [self._cubes[trial.number] for trial in trials]
        return np.array(rows).reshape(-1, self._space.dimension)

    def observations(
        self, trials: Sequence[Trial], metric: str
    ) -> tuple[Array, Array, NDArray[np.int_]]:
        """Return points (N, d), values (N,) and trial numbers (N,) of `Trial.observations`."""
        values = [trial.observations(metric) for trial in trials]
        counts = [len(of_trial) for of_trial in values]
        x = np.repeat(self.points(trials), counts, axis=0)
        number = np.repeat([trial.number for trial in trials], counts)
        return x, np.array([value for of_trial in values for value in of_trial]), number
