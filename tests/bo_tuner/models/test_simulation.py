"""A simulation as prior knowledge of the machine, against closed forms.

The simulation's error is sin(6 π gain) / 10 + 0.1 load, the machine's is OFFSET + SLOPE gain more;
the peak is higher by half as much. Few runs of the machine, at multiples of a quarter, do not show
the waves.
"""

import numpy as np
import pytest
from functions import make_study
from pooled_data import PLAIN
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF, ConstantKernel

from bo_tuner.errors import StudyError
from bo_tuner.methods.registry import METHODS
from bo_tuner.models.pooled_models import PooledModels
from bo_tuner.models.pooled_process import PooledProcess
from bo_tuner.models.simulation import APART, SIMULATED, Simulation, is_simulated, moved
from bo_tuner.trials import Evaluation, EvaluationState, Outcome, Stage, Trial, TrialState

OFFSET, SLOPE, NOISE = 0.5, 0.2, 0.01
GAINS = np.linspace(0.0, 1.0, 11)[:, None]
FEW = [0.0, 0.25, 0.5, 0.75, 1.0]
PEAK = {"metric": "peak", "upper": 2.0}


def study(kind="worst_case", **sections):
    how = {"kind": "chance", "probability": 0.9} if kind == "chance" else {"kind": kind}
    return make_study(constraints={"peak": PEAK | how}, **sections)


def waves(gain):
    return 0.1 * np.sin(6.0 * np.pi * gain)


def trial(number, gain, machine, rng, each=3, state=EvaluationState.COMPLETE):
    """A trial with runs in random loads."""
    parameters, higher = {"gain": float(gain)}, (OFFSET + SLOPE * gain) * machine
    evaluations = []
    for k in range(each):
        load, noise = float(rng.uniform(1.0, 2.0)), NOISE * rng.standard_normal(2)
        metrics = {
            "error": waves(gain) + 0.1 * load + higher + noise[0],
            "peak": 0.5 * gain + 0.25 * load + 0.5 * higher + noise[1],
        }
        outcome = Outcome(state, metrics if state is EvaluationState.COMPLETE else {}, "")
        evaluations.append(
            Evaluation(number, k, Stage.DRAWN, parameters, {"load": load}, k, outcome)
        )
    ended = TrialState.COMPLETE if state is EvaluationState.COMPLETE else TrialState.FAILED
    return Trial(number, parameters, "", ended, "", tuple(evaluations))


def both(gains, seed=1):
    """25 trials of the simulation, and some of the machine."""
    rng = np.random.default_rng(seed)
    simulated = [trial(k, gain, False, rng) for k, gain in enumerate(np.linspace(0.0, 1.0, 25))]
    return simulated, [trial(k, gain, True, rng) for k, gain in enumerate(gains)]


def fitted(of_study, machine, simulated=()):
    models = PooledModels(simulation=Simulation.of(of_study, simulated))
    return models(of_study, machine, rng=np.random.default_rng(0))


def error(gains):
    """The machine's mean error; the mean load is 1.5."""
    return waves(gains) + 0.15 + OFFSET + SLOPE * gains


class TestPredictions:
    @pytest.mark.parametrize("kind", ["worst_case", "chance"])
    def test_few_runs_of_the_machine_suffice(self, kind):
        simulated, machine = both(FEW)
        without = fitted(study(kind), machine)
        knowing = fitted(study(kind), machine, simulated)
        off = [
            np.abs(m.objective.predict_mean(GAINS) - error(GAINS[:, 0])).max()
            for m in (without, knowing)
        ]
        assert off[1] < 0.04 < 0.08 < off[0]

    def test_a_constant_bias_is_known_from_one_shared_parameter_set(self):
        simulated, machine = both([0.5])
        models = fitted(study(), machine, simulated)
        # Elsewhere the slope, of which nothing is known, makes at most half of it.
        assert models.objective.predict_mean(GAINS) == pytest.approx(
            error(GAINS[:, 0]), abs=0.5 * SLOPE + 0.05
        )

    def test_limits_are_those_of_the_machine(self):
        """The worst load is 2: 0.5 gain + 0.5 + half of what is higher."""
        simulated, machine = both(FEW)
        limit = fitted(study(), machine, simulated).constraints["peak"]
        gains = GAINS[:, 0]
        truth = 0.5 * gains + 0.5 + 0.5 * (OFFSET + SLOPE * gains)
        assert limit.predict_mean(GAINS) == pytest.approx(truth, abs=0.03)

    def test_only_the_machine_has_tried_parameter_sets(self):
        simulated, machine = both([0.25, 0.5, 0.25])
        objective = fitted(study(), machine, simulated).objective
        assert sorted(objective.points[:, 0].tolist()) == [0.25, 0.5]
        assert sorted(objective.counts.tolist()) == [3, 6]
        assert objective.evaluated(np.array([[0.25], [0.0]])).tolist() == [True, False]

    def test_without_runs_of_the_machine_nothing_is_predicted(self):
        simulated, _ = both([])
        assert fitted(study(), [], simulated).objective is None

    def test_a_region_where_the_simulation_crashes_is_known(self):
        rng = np.random.default_rng(1)
        crashed = [
            trial(k, gain, False, rng, state=EvaluationState.FAILED)
            for k, gain in enumerate((0.8, 0.85, 0.9, 0.95, 1.0))
        ]
        fine = [trial(9 + k, gain, False, rng) for k, gain in enumerate((0.0, 0.1, 0.2, 0.3, 0.4))]
        _, machine = both([0.1, 0.3])
        crashes = fitted(study(), machine, [*fine, *crashed]).crashes
        low, high = crashes.probability(np.array([[0.2], [0.9]]))
        assert low < 0.2 < 0.8 < high


class TestBias:
    @pytest.mark.parametrize("seed", [1, 2, 3])
    @pytest.mark.parametrize("kind", ["worst_case", "chance"])
    def test_it_is_what_the_machine_has_more(self, kind, seed):
        simulated, machine = both(FEW, seed)
        comparisons = fitted(study(kind), machine, simulated).comparisons
        assert comparisons.keys() == {"error", "peak"}
        for gain in (0.25, 0.5):
            higher = OFFSET + SLOPE * gain
            for metric, truth in (("error", higher), ("peak", 0.5 * higher)):
                bias = comparisons[metric].bias(metric, np.array([[gain]]))
                assert bias.low < bias.difference < bias.high
                assert bias.difference == pytest.approx(truth, abs=0.03)
        found = comparisons["error"].bias("error", np.array([[0.5]]))
        assert found.simulated == pytest.approx(0.15, abs=0.02)

    def test_of_what_is_maximized(self):
        simulated, machine = both(FEW)
        largest = study(objective={"metric": "error", "direction": "maximize"})
        bias = fitted(largest, machine, simulated).comparisons["error"]
        known = bias.bias("error", np.array([[0.5]]))
        assert known.low < known.difference < known.high
        assert known.difference == pytest.approx(OFFSET + 0.5 * SLOPE, abs=0.03)

    def test_without_a_simulation_there_is_none(self):
        _, machine = both(FEW)
        assert fitted(study(), machine).comparisons == {}

    def test_its_variance_is_that_of_a_difference(self):
        """Against the joint posterior of another library."""
        rng = np.random.default_rng(2)
        x, y = rng.random((12, 1)), rng.standard_normal(12)
        c = np.where(np.arange(12) % 2 == 0, SIMULATED, APART)[:, None]
        process = PooledProcess.fit(x, c, y, coding=PLAIN, rng=rng)
        known = process.hyperparameters
        kernel = ConstantKernel(known.signal**2, "fixed") * RBF(known.length_scales, "fixed")
        other = GaussianProcessRegressor(
            kernel + ConstantKernel(1.0, "fixed"),
            alpha=process.posterior.variances[process.data.index],
            optimizer=None,
        ).fit(np.hstack([x, c]), process.standardization.apply(y))
        query = np.array([[0.3, APART], [0.3, SIMULATED]])
        _, covariance = other.predict(query, return_cov=True)
        weights = np.array([[1.0, -1.0]])
        expected = (weights @ covariance @ weights.T)[0, 0] * process.scale**2
        variance = process.variance_of_weighted(query[:1, :1], query[:, 1:], weights, 0.0)
        assert variance[0] == pytest.approx(expected, rel=1e-6)


class TestMoved:
    X = np.array([[0.1], [0.1], [0.5], [0.5], [0.9], [0.7]])
    SIMULATED = np.array([True, False, True, False, True, False])

    def test_the_mean_difference_at_shared_parameter_sets(self):
        y = np.array([1.0, 3.0, 2.0, 6.0, 5.0, 7.0])
        values, offset = moved(self.X, y, self.SIMULATED)
        assert offset == 3.0
        assert values.tolist() == [4.0, 3.0, 5.0, 6.0, 8.0, 7.0]

    def test_without_any_nothing_is_moved(self):
        values, offset = moved(np.arange(6.0)[:, None], np.ones(6), self.SIMULATED)
        assert (offset, values.tolist()) == (0.0, [1.0] * 6)


class TestSimulation:
    def test_its_trials_have_numbers_that_no_trial_of_a_run_has(self):
        simulated, machine = both([0.5])
        known = Simulation.of(study(), [*simulated, simulated[0]])
        assert [t.number for t in known.trials] == list(range(-1, -26, -1))
        assert len(known.trials[0].evaluations) == 6
        assert all(is_simulated(t) for t in known.trials)
        assert not any(is_simulated(t) for t in machine)

    def test_outliers_are_no_data(self):
        simulated, machine = both([0.5])
        off = trial(25, 0.97, False, np.random.default_rng(3))
        far = [
            Evaluation(
                e.trial, e.index, e.stage, e.parameters, e.context, e.seed,
                Outcome(EvaluationState.COMPLETE, e.outcome.metrics | {"error": 1e4}),
            )
            for e in off.evaluations
        ]  # fmt: skip
        outlying = Trial(25, off.parameters, "", TrialState.COMPLETE, "", tuple(far))
        known = Simulation.of(study(), [*simulated, outlying])
        assert known.outliers == {-26}
        models = PooledModels(simulation=known)(study(), machine, rng=np.random.default_rng(0))
        assert models.objective.scale < 1.0
        assert models.outlying.probability(np.array([[0.97]]))[0] > 0.5


class TestMethods:
    def test_others_refuse(self):
        """What is safe on the machine is to be known from the machine alone."""
        for name in METHODS.keys() - {"boundary"}:
            with pytest.raises(StudyError, match="takes no runs of a simulation"):
                METHODS[name].knowing(study(), both([])[0])

    def test_runs_that_may_be_cut_short_are_refused(self):
        short = {"trials": 5, "initial_trials": 2, "cut_short": True}
        growing = {
            "error": {"node": "axis", "grows": True},
            "peak": {"node": "axis", "grows": True},
        }
        of_study = study(metrics=growing, budget=short)
        with pytest.raises(StudyError, match="needs whole runs beside a simulation"):
            METHODS["boundary"].knowing(of_study, both([])[0])
