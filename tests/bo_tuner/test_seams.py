"""Parts from outside the package: an acquisition, a surrogate and a metric source of one's own."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from bo_tuner.metrics.source import MissingMetricError
from bo_tuner.models.fitting import ModelOptions
from bo_tuner.optimizers.algorithms import ALGORITHMS
from bo_tuner.optimizers.base import ACQUISITION
from bo_tuner.tuning.loop import Tuning
from bo_tuner.worst_case.reinterpolation_search import ReinterpolationSearch


def valley(gain, load, seed):
    return {"error": 1.0 + (gain - 0.3) ** 2, "peak": 0.5}


def tune(study, backend, algorithm):
    return list(Tuning(study, backend, algorithm))


class TestAcquisition:
    """Towards one point, whatever the models say."""

    def test_it_decides_where_to_go(self, make_study, function_backend):
        def towards(surrogates, incumbent, *, avoid, reinterpolate):
            return lambda x: -np.abs(x[:, 0] - 0.8125)

        algorithm = replace(ALGORITHMS["IV"], acquisition=towards)
        study = make_study().replace(trials=4)
        trials = tune(study, function_backend(study, valley), algorithm)
        assert trials[3].origin == ACQUISITION
        assert trials[3].parameters["gain"] == pytest.approx(0.8125, abs=1e-3)


@dataclass
class NearestMean:
    """Predicts the mean of the nearest point; a model that knows nothing of Gaussian processes."""

    points: np.ndarray
    counts: np.ndarray
    means: np.ndarray
    scale: float
    warnings = ()
    warm_start = ()
    noise_variance = 0.01

    @classmethod
    def fit(cls, x, y, *, rng, minimum_length_scales=None, start=None, keep=False):
        points, inverse, counts = np.unique(
            np.asarray(x), axis=0, return_inverse=True, return_counts=True
        )
        means = np.bincount(inverse.ravel(), weights=y) / counts
        cls.fitted += 1
        return cls(points, counts, means, float(np.std(y)) or 1.0)

    fitted = 0

    @property
    def length_scales(self):
        return np.full(self.points.shape[1], 0.5)

    def predict(self, x):
        distance = np.abs(np.asarray(x)[:, None, :] - self.points).max(axis=2)
        return self.means[distance.argmin(axis=1)], distance.min(axis=1) ** 2

    def predict_mean(self, x):
        return self.predict(x)[0]

    def predict_reinterpolated(self, x):
        return self.predict(x)


class TestSurrogate:
    @pytest.mark.parametrize("joint", [False, True])
    def test_it_stands_for_every_response(self, make_study, function_backend, joint):
        # The joint search of Algorithm V fits a Gaussian process of its own.
        models = ModelOptions(reject_outliers=False, joint=joint, fit=NearestMean.fit)
        algorithm = replace(ALGORITHMS["IV"], models=models)
        NearestMean.fitted = 0
        study = make_study().replace(trials=6)
        trials = tune(study, function_backend(study, valley), algorithm)
        assert NearestMean.fitted >= 2 * 3
        assert [t.origin for t in trials[3:]] == [ACQUISITION] * 3
        assert not any(t.warnings for t in trials)


class Difference:
    """A metric that is the difference of two figures of a node."""

    def value(self, results):
        figures = results["axis"]
        try:
            return figures["peak"] - figures["error"]
        except KeyError as error:
            raise MissingMetricError(f"axis: no {error}") from None


class TestMetricSource:
    def test_it_takes_the_place_of_a_figure(self, make_study, function_backend):
        study = make_study()
        backend = function_backend(study, valley, {"peak": Difference()})
        (trial, *_) = tune(study, backend, ALGORITHMS["I"])
        gain = trial.parameters["gain"]
        (evaluation,) = trial.evaluations
        assert evaluation.outcome.metrics["peak"] == pytest.approx(-0.5 - (gain - 0.3) ** 2)

    def test_what_it_lacks_fails_the_evaluation(self, make_study, function_backend):
        study = make_study()
        backend = function_backend(study, lambda **_: {"peak": 1.0}, {"error": Difference()})
        (trial, *_) = tune(study, backend, ALGORITHMS["I"])
        assert trial.reason == "axis: no 'error'"


class TestWorstCaseSearch:
    def test_an_algorithm_brings_its_own(self, make_study, function_backend):
        asked = []

        @dataclass(frozen=True)
        class Corners(type(ALGORITHMS["IV"])):
            def worst_case_search(self, study, constraint, proposal, trials):
                class Search(ReinterpolationSearch):
                    def ask(self, rng):
                        self._asked += 1
                        asked.append(self._asked)
                        return {"load": 2.0}

                return Search(study.context_space(), constraint.upper, 2)

        study = make_study().replace(trials=2)
        trials = tune(study, function_backend(study, valley), Corners("corners only"))
        searched = [e.context for t in trials for e in t.evaluations if e.stage == "search"]
        assert searched == [{"load": 2.0}] * 4
        assert asked == [1, 2, 1, 2]
