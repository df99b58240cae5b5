"""The posterior of a context, against closed forms of a linear simulator."""

import numpy as np
import pytest

from bo_tuner.models.context_posterior import Emulator, RealRuns, infer_context, noise_of
from bo_tuner.study.context_space import ContextSpace
from bo_tuner.study.distributions import Discrete, Uniform

SPACE = ContextSpace({"load": Uniform(bounds=(1.0, 3.0))})
NOISE = np.array([[0.01, 0.006], [0.006, 0.04]])


def simulate(loads, rng, shift=(0.0, 0.0), covariance=NOISE):
    """Metrics (n, 2): the load and minus its double, with correlated noise."""
    loads = np.asarray(loads, dtype=float)
    noise = rng.multivariate_normal([0.0, 0.0], covariance, size=len(loads))
    return np.stack([loads, -2.0 * loads], axis=1) + noise + shift


class Line:
    """A metric that is known: a slope times the load."""

    def __init__(self, slope):
        self.slope = slope

    def predict(self, cube):
        load = 1.0 + 2.0 * cube[:, 0]
        return self.slope * load, np.zeros(len(load))


@pytest.fixture(scope="module")
def emulator():
    rng = np.random.default_rng(0)
    loads = SPACE.draw_stratified(200, rng)
    return Emulator.fit(SPACE.to_cube(loads), simulate(loads[:, 0], rng), rng)


def infer(emulator, values, seed=1):
    return infer_context(SPACE, [emulator], [RealRuns(values)], np.random.default_rng(seed))


def test_the_emulator_is_the_simulator(emulator):
    mean, variance = emulator.predict(SPACE.to_cube([[1.5], [2.5]]))
    assert mean == pytest.approx(np.array([[1.5, -3.0], [2.5, -5.0]]), abs=0.1)
    assert (variance < 0.005).all()
    deviations, expected = np.sqrt(np.diag(emulator.noise)), np.sqrt(np.diag(NOISE))
    assert deviations == pytest.approx(expected, rel=0.2)
    assert emulator.noise[0, 1] / deviations.prod() == pytest.approx(0.3, abs=0.2)


def test_the_noise_is_that_of_the_latest_runs():
    """Here it is a tenth of that of the first ones, which are farther away."""
    rng = np.random.default_rng(0)
    loads = np.concatenate([np.linspace(1.0, 3.0, 60), rng.uniform(1.9, 2.1, 60)])
    values = np.vstack(
        [simulate(loads[:60], rng), simulate(loads[60:], rng, covariance=0.01 * NOISE)]
    )
    cube = SPACE.to_cube(loads[:, None])
    local = Emulator.fit(cube, values, rng, latest=60)
    assert np.sqrt(np.diag(local.noise)) == pytest.approx([0.01, 0.02], rel=0.5)
    assert np.diag(Emulator.fit(cube, values, rng).noise)[0] > 10.0 * local.noise[0, 0]


def test_the_posterior_is_that_of_a_normal_mean(emulator):
    """Of y = a c with noise Σ and n runs it is normal with the variance 1 / (n aᵀ Σ⁻¹ a)."""
    values = simulate(np.full(8, 2.2), np.random.default_rng(4))
    slope = np.array([1.0, -2.0])
    weights = np.linalg.solve(NOISE, slope)
    precision = 8 * slope @ weights
    posterior = infer(emulator, values)
    loads = posterior.contexts[:, 0]
    assert loads.mean() == pytest.approx(8 * weights @ values.mean(axis=0) / precision, abs=0.04)
    # What the emulator does not know comes on top.
    assert precision**-0.5 * 0.9 < loads.std() < precision**-0.5 * 1.8
    assert posterior.misfits(0.01) == []


def test_runs_that_a_context_explains_are_seldom_called_a_misfit():
    emulator = Emulator((Line(1.0), Line(-2.0)), NOISE, 1e6)
    rng = np.random.default_rng(8)
    loads = rng.uniform(1.1, 2.9, 30)
    called = [bool(infer(emulator, simulate(np.full(5, c), rng)).misfits(0.05)) for c in loads]
    assert sum(called) <= 4


def test_metrics_that_no_context_has_together_are_a_misfit(emulator):
    """Each of them alone would fit some load, but not the same one."""
    values = simulate(np.full(6, 2.0), np.random.default_rng(3), shift=(0.6, 0.6))
    misfits = infer(emulator, values).misfits(0.01)
    assert misfits[0].metric is None
    assert not any(test.of_scatter for test in misfits)


def test_a_mean_beyond_the_box_is_a_misfit_with_its_side(emulator):
    values = simulate(np.full(6, 3.6), np.random.default_rng(3))
    sides = {t.metric: np.sign(t.deviations) for t in infer(emulator, values).misfits(0.01)}
    assert sides[0] == 1.0
    assert sides[1] == -1.0


def test_more_scatter_than_the_simulator_has_is_a_misfit(emulator):
    values = simulate(np.full(10, 2.0), np.random.default_rng(3), covariance=16.0 * NOISE)
    scattered = [test for test in infer(emulator, values).misfits(0.01) if test.of_scatter]
    assert {test.metric for test in scattered} == {0, 1}
    assert all(2.0 < test.deviations < 6.0 for test in scattered)


def test_two_parameter_sets_tell_more_than_one(emulator):
    rng = np.random.default_rng(5)
    runs = [RealRuns(simulate(np.full(4, 1.7), rng)) for _ in range(2)]
    one, both = (
        infer_context(SPACE, [emulator] * len(known), known, np.random.default_rng(1))
        for known in (runs[:1], runs)
    )
    assert both.contexts.std() < 0.9 * one.contexts.std()


def test_a_discrete_context():
    """Three values of which one fits; the others have no sample."""
    space = ContextSpace({"tool": Discrete(values=("drill", "mill", "saw"))})
    rng = np.random.default_rng(0)
    tools = space.draw(60, rng)
    emulator = Emulator.fit(space.to_cube(tools), tools + 0.05 * rng.normal(size=(60, 1)), rng)
    posterior = infer_context(space, [emulator], [RealRuns(np.array([[1.02], [0.97]]))], rng)
    assert set(posterior.contexts[:, 0]) == {1.0}


def test_the_noise_of_a_machine():
    """Its variance is the pooled one; a correlation is shrunk, so that it cannot be ±1."""
    first, second = np.array([[1.0, 2.0], [3.0, 4.0]]), np.array([[0.0, 0.0], [0.0, 0.0], [3, 3]])
    noise = noise_of([RealRuns(first), RealRuns(second)])
    assert np.diag(noise) == pytest.approx([(2.0 + 6.0) / 3.0] * 2)
    assert noise[0, 1] == pytest.approx(8.0 / 3.0 * 3.0 / 5.0)
    with pytest.raises(ValueError, match="expected at least 2 repeated runs, found 1"):
        noise_of([RealRuns(first)])
