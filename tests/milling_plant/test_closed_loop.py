"""The scenario's table: closed loop of plant, filter and controller.

The table was measured with a linear MPC whose input is clipped; `clipped_law` is an independent
implementation of it. Our controller solves the program with its limits. Where these are never
active both are the same controller. Where they are, the exact solution tracks better, so that our
loop is tied to the law by clipping our own input in the same way.
"""

import functools

import clipped_law
import numpy as np
import pytest
from scenario_table import NAMES, TABLE
from scipy.stats import truncnorm

from milling_plant.cut import MillingPlant
from mpc_controller import controller as controller_module
from mpc_controller.controller import MpcController
from mpc_controller.mpc import Mpc

OVERSHOOT_LIMIT = 0.09
WORST_CORNER = (1.3, 0.7)

LIMITS_ACTIVE = [(15, 15, -3.0, -1.0), (2, 4, -3.9, 2.0)]
LIMITS_INACTIVE = [row for row in TABLE if row not in LIMITS_ACTIVE]
# Expected error at the optimum found by dense search, benchmark and full case.
OPTIMA = {(9, 9, -0.9, -1.0): 0.168, (1, 4, -3.3, -0.9): 0.165}

GRID = np.array([(s, d) for s in np.linspace(0.7, 1.3, 7) for d in np.linspace(0.7, 1.3, 7)])


def drawn_contexts(count):
    """Contexts (count, 2) from the scenario's distribution."""
    bound = 0.3 / 0.2
    rng = np.random.default_rng(1)
    return truncnorm.rvs(-bound, bound, loc=1.0, scale=0.2, size=(count, 2), random_state=rng)


class Law:
    """Responses of the clipped law in one row, with small sampling errors."""

    def __init__(self, row):
        rng = np.random.default_rng(2)
        contexts, repetitions = drawn_contexts(1500), 100
        drawn = clipped_law.simulate(row, *contexts.T, clipped_law.draw_noise(rng, 1500))
        nominal = clipped_law.simulate(
            row, np.ones(400), np.ones(400), clipped_law.draw_noise(rng, 400)
        )
        every = np.repeat(GRID, repetitions, axis=0)
        grid = clipped_law.simulate(row, *every.T, clipped_law.draw_noise(rng, len(every)))
        self.expected_error = drawn.tracking_error.mean()
        self.nominal_error = nominal.tracking_error.mean()
        self.overshoot = grid.overshoot.reshape(len(GRID), repetitions).mean(axis=1)
        self.worst_overshoot = self.overshoot.max()


@pytest.fixture(scope="module")
def law():
    """Function that returns the responses of the clipped law in a row."""
    return functools.cache(Law)


class Loop:
    """Our plant and controller."""

    def __init__(self):
        self.plant, self.controller = MillingPlant(), MpcController()

    def run(self, row, context, seed):
        """One cut: tracking error and overshoot; also kept are its true velocity and commands."""
        self.controller.set_parameters(dict(zip(NAMES, row, strict=True)))
        stiffness, damping = (float(factor) for factor in context)
        self.plant.set_parameters(
            {"stiffness_factor": stiffness, "damping_factor": damping, "seed": seed}
        )
        result = self.plant.run_cut(self.controller)
        assert self.controller.cut_result()["status"] == "ok"
        self.velocity = self.plant.velocity
        return result["tracking_error"], result["overshoot"]


@pytest.fixture
def loop():
    return Loop()


def law_with_noise_of(row, contexts, seeds):
    """The clipped law in the contexts and with the noise of our cuts of these seeds."""
    noise = np.column_stack(
        [np.random.default_rng(seed).normal(0.0, np.sqrt(0.001), 270) for seed in seeds]
    )
    return clipped_law.simulate(row, *np.transpose(contexts), noise)


def difference_to_law(loop, row, contexts, seeds):
    """Mean of our (tracking error, overshoot) less the law's, on the same contexts and noise."""
    ours = np.array([loop.run(row, c, s) for c, s in zip(contexts, seeds, strict=True)])
    theirs = law_with_noise_of(row, contexts, seeds)
    return np.mean(ours - np.column_stack([theirs.tracking_error, theirs.overshoot]), axis=0)


@pytest.mark.parametrize("row", TABLE, ids=str)
def test_independent_law_reproduces_the_table(law, row):
    expected_error, worst_overshoot, nominal_error, feasible = TABLE[row]
    assert law(row).expected_error == pytest.approx(expected_error, rel=0.05)
    assert law(row).nominal_error == pytest.approx(nominal_error, rel=0.05)
    assert law(row).worst_overshoot == pytest.approx(worst_overshoot, abs=0.01)
    assert (law(row).worst_overshoot <= OVERSHOOT_LIMIT) == feasible


@pytest.mark.parametrize("row", TABLE, ids=str)
def test_our_controller_with_a_clipped_input_is_the_law(monkeypatch, loop, row):
    """Plant, filter, weights, preview and metrics are those of the law, sample by sample."""

    class ClippedMpc(Mpc):
        def __init__(self, program, lower, upper):
            super().__init__(program, -1e3, 1e3)
            self._lower, self._upper = lower, upper

    monkeypatch.setattr(controller_module, "Mpc", ClippedMpc)
    contexts, seeds = [(1.0, 1.0), WORST_CORNER, (0.8, 1.1)], [11, 12, 13]
    theirs = law_with_noise_of(row, contexts, seeds)
    for i, (context, seed) in enumerate(zip(contexts, seeds, strict=True)):
        error, overshoot = loop.run(row, context, seed)
        np.testing.assert_allclose(loop.velocity, theirs.velocity[:, i], atol=2e-4)
        assert error == pytest.approx(theirs.tracking_error[i], rel=1e-3)
        assert overshoot == pytest.approx(theirs.overshoot[i], abs=2e-4)


@pytest.mark.parametrize("row", LIMITS_INACTIVE, ids=str)
def test_our_controller_reproduces_the_rows_without_active_limits(law, loop, row):
    expected_error, worst_overshoot, nominal_error, feasible = TABLE[row]
    more_error, _ = difference_to_law(loop, row, drawn_contexts(20), range(20))
    assert law(row).expected_error + more_error == pytest.approx(expected_error, rel=0.05)
    more_error, _ = difference_to_law(loop, row, [(1.0, 1.0)] * 8, range(8))
    assert law(row).nominal_error + more_error == pytest.approx(nominal_error, rel=0.05)
    _, more_overshoot = difference_to_law(loop, row, [WORST_CORNER] * 12, range(12))
    worst = law(row).worst_overshoot + more_overshoot
    assert worst == pytest.approx(worst_overshoot, abs=0.01)
    assert (worst <= OVERSHOOT_LIMIT) == feasible


@pytest.mark.parametrize("row", LIMITS_ACTIVE, ids=str)
def test_with_active_limits_our_controller_tracks_better_and_is_judged_alike(law, loop, row):
    expected_error, _, _, feasible = TABLE[row]
    more_error, _ = difference_to_law(loop, row, drawn_contexts(20), range(20))
    assert law(row).expected_error + more_error < expected_error
    _, more_overshoot = difference_to_law(loop, row, [WORST_CORNER] * 20, range(20))
    assert (law(row).worst_overshoot + more_overshoot <= OVERSHOOT_LIMIT) == feasible


@pytest.mark.parametrize("row", OPTIMA, ids=str)
def test_optima_of_the_dense_search(loop, row):
    errors = [loop.run(row, c, seed)[0] for seed, c in enumerate(drawn_contexts(60))]
    assert np.mean(errors) == pytest.approx(OPTIMA[row], rel=0.05)


@pytest.mark.parametrize("row", TABLE, ids=str)
def test_worst_context_is_stiff_and_weakly_damped(law, row):
    assert tuple(GRID[law(row).overshoot.argmax()]) == pytest.approx(WORST_CORNER)


@pytest.mark.parametrize("row", [(15, 15, -3.0, -1.0), (8, 8, -0.75, -1.0)], ids=str)
def test_worst_corner_of_our_loop(loop, row):
    contexts = [(1.3, 0.7), (1.3, 1.3), (0.7, 0.7), (0.7, 1.3), (1.0, 1.0)]
    overshoots = [np.mean([loop.run(row, c, seed)[1] for seed in range(5)]) for c in contexts]
    assert np.argmax(overshoots) == 0


@pytest.mark.parametrize("lambda_mpc", [-5.0, -3.0, -1.0, 1.0])
def test_a_horizon_of_one_does_not_see_its_input_and_never_moves(loop, lambda_mpc):
    """The deterministic outliers: with one sample of dead time the axis stays where it is."""
    error, overshoot = loop.run((1, 1, lambda_mpc, -1.0), (1.0, 1.0), 0)
    assert error == pytest.approx(45 * (0.35**2 + 0.26**2 + 0.18**2), rel=1e-4)
    assert overshoot == pytest.approx(0.0, abs=1e-4)


@pytest.mark.parametrize("horizon", [1, 2, 3, 4])
def test_short_horizons_with_a_large_weight_track_very_badly(loop, horizon):
    error, _ = loop.run((horizon, horizon, 1.0, -1.0), (1.0, 1.0), 0)
    assert 1.0 < error < 40.0


@pytest.mark.parametrize("lambda_mpc", [-5.0, -3.0, -1.0])
def test_surface_is_flat_in_the_control_horizon_above_about_eight(loop, lambda_mpc):
    errors = [loop.run((h, h, lambda_mpc, -1.0), (1.0, 1.0), 0)[0] for h in (9, 12, 16, 20)]
    assert max(errors) / min(errors) < 1.03
    short = loop.run((2, 2, lambda_mpc, -1.0), (1.0, 1.0), 0)[0]
    assert short > 1.5 * max(errors)


@pytest.mark.parametrize("horizon", [6, 12, 20])
@pytest.mark.parametrize("lambda_mpc", [-5.0, -4.0, -3.0, -2.0])
def test_small_weights_overshoot(loop, horizon, lambda_mpc):
    row = (horizon, horizon, lambda_mpc, -1.0)
    assert np.mean([loop.run(row, WORST_CORNER, s)[1] for s in range(3)]) > OVERSHOOT_LIMIT
