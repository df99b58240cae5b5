"""The first input against independent solutions of the original problem."""

import numpy as np
import pytest
from dense_mpc import DenseMpc
from hypothesis import given
from hypothesis import strategies as st
from second_order import DelayLine, matrices

from feed_axis_common.model import delay_augmented, feed_axis
from mpc_controller import mpc as mpc_module
from mpc_controller.mpc import Mpc
from mpc_controller.qp import condense

SAMPLE_TIME = 0.02
LOWER, UPPER = 0.0, 1.2
HORIZONS = [(1, 1), (1, 2), (1, 4), (2, 4), (5, 5), (4, 20), (15, 15), (20, 25)]


class Problem:
    """One sample's data: a state, the last input and a preview of steps."""

    def __init__(self, rng, delay, horizon):
        self.x = np.array([rng.uniform(0.0, 1.2), rng.normal(0.0, 4.0)])
        self.past = rng.uniform(LOWER, UPPER, delay)
        self.last = self.past[-1] if delay else rng.uniform(LOWER, UPPER)
        self.preview = np.repeat(rng.uniform(0.3, 0.9, horizon), 6)[rng.integers(6) :][:horizon]
        self.delay = delay

    @property
    def state(self):
        return np.concatenate((self.x, self.past))

    def predict(self, inputs):
        axis = DelayLine(matrices(1.0, 1.0, 26.0), SAMPLE_TIME, self.delay, self.x, self.past)
        return np.array([axis.step(u) for u in inputs])


def make_mpc(delay, moves, outputs, lambda_mpc, lower=LOWER, upper=UPPER):
    model = delay_augmented(*feed_axis(1.0, 1.0, 26.0), SAMPLE_TIME, delay * SAMPLE_TIME)
    return Mpc(condense(model, moves, outputs, lambda_mpc), lower, upper)


@pytest.mark.parametrize("lambda_mpc", [-8.0, -5.0, -3.9, -1.0, 1.0])
@pytest.mark.parametrize(("moves", "outputs"), HORIZONS)
@pytest.mark.parametrize("delay", [0, 1, 2])
def test_first_input_is_that_of_another_solver(delay, moves, outputs, lambda_mpc):
    rng = np.random.default_rng([delay, moves, outputs])
    mpc = make_mpc(delay, moves, outputs, lambda_mpc)
    for _ in range(6):
        problem = Problem(rng, delay, outputs)
        dense = DenseMpc(problem.predict, moves, outputs, lambda_mpc)
        expected = dense.constrained(problem.last, problem.preview, LOWER, UPPER)
        solution = mpc.solve(problem.state, problem.last, problem.preview)
        assert solution.status == "solved"
        assert solution.input == pytest.approx(expected[0], abs=1e-4)


def test_active_limits_make_the_difference_to_a_clipped_law():
    """The comparison above is not one of cases that never meet their limits."""
    rng = np.random.default_rng(0)
    active, different = 0, 0
    for _ in range(50):
        problem = Problem(rng, 1, 8)
        dense = DenseMpc(problem.predict, 8, 8, -3.0)
        U = dense.constrained(problem.last, problem.preview, LOWER, UPPER)
        clipped = np.clip(dense.unconstrained(problem.last, problem.preview), LOWER, UPPER)
        active += bool(np.any((U <= LOWER) | (U >= UPPER)))
        different += abs(U[0] - clipped[0]) > 0.01
    assert active > 25
    assert different > 3


@pytest.mark.parametrize("lambda_mpc", [-5.0, -2.0, 1.0])
@pytest.mark.parametrize(("moves", "outputs"), [(1, 3), (5, 5), (8, 20)])
def test_far_from_the_limits_the_law_is_linear(moves, outputs, lambda_mpc):
    mpc = make_mpc(1, moves, outputs, lambda_mpc, -1e3, 1e3)
    rng = np.random.default_rng(moves)
    for _ in range(5):
        problem = Problem(rng, 1, outputs)
        dense = DenseMpc(problem.predict, moves, outputs, lambda_mpc)
        expected = dense.unconstrained(problem.last, problem.preview)[0]
        solution = mpc.solve(problem.state, problem.last, problem.preview)
        assert solution.input == pytest.approx(expected, abs=1e-4)


def test_a_horizon_of_one_behind_one_sample_of_dead_time_never_moves():
    """No output within the horizon sees the input, so that only its own weight counts."""
    mpc = make_mpc(1, 1, 1, -3.0)
    for last in (0.0, 0.37, 1.2):
        solution = mpc.solve(np.array([0.5, 0.0, last]), last, np.array([1.0]))
        assert solution.input == pytest.approx(last, abs=1e-5)


def test_inputs_after_the_control_horizon_are_held():
    """A step at the end of the preview moves a held input much, the first of free ones little."""
    x, preview = np.array([0.5, 0.0, 0.5]), np.array([0.5] * 7 + [0.9])
    held = make_mpc(1, 1, 8, -5.0).solve(x, 0.5, preview).input
    free = make_mpc(1, 8, 8, -5.0).solve(x, 0.5, preview).input
    assert held - 0.5 > 0.02
    assert abs(free - 0.5) < 0.5 * (held - 0.5)


@pytest.mark.parametrize("delay", [0, 1, 2])
def test_at_rest_on_a_constant_reference_nothing_moves(delay):
    mpc = make_mpc(delay, 5, 10, -3.0)
    x = np.concatenate(([0.6, 0.0], np.full(delay, 0.6)))
    assert mpc.solve(x, 0.6, np.full(10, 0.6)).input == pytest.approx(0.6, abs=1e-5)


def test_equal_data_give_equal_results_bit_for_bit():
    records = []
    for _ in range(2):
        rng = np.random.default_rng(5)
        mpc = make_mpc(1, 10, 12, -4.0)
        records.append(
            [
                mpc.solve(p.state, p.last, p.preview)
                for p in (Problem(rng, 1, 12) for _ in range(40))
            ]
        )
    assert records[0] == records[1]


def test_no_solver_setting_depends_on_the_clock():
    settings = mpc_module.SOLVER_SETTINGS
    assert settings["adaptive_rho"] == 1  # by iterations; 2 and 3 are by time and by error
    assert settings["adaptive_rho_interval"] > 0
    assert "time_limit" not in settings


@given(
    moves=st.integers(1, 12),
    extra=st.integers(0, 12),
    lambda_mpc=st.floats(-8.0, 8.0),
    lower=st.floats(-2.0, 2.0),
    width=st.floats(1e-3, 3.0),
    seed=st.integers(0, 1000),
    size=st.sampled_from([1.0, 1e3, 1e9, 1e150]),
)
def test_input_limits_hold_for_any_data(moves, extra, lambda_mpc, lower, width, seed, size):
    outputs = moves + extra
    mpc = make_mpc(1, moves, outputs, lambda_mpc, lower, lower + width)
    rng = np.random.default_rng(seed)
    for _ in range(5):
        solution = mpc.solve(
            size * rng.normal(size=3), rng.normal(), size * rng.normal(size=outputs)
        )
        if solution.input is None:
            assert solution.status != "solved"
        else:
            assert lower <= solution.input <= lower + width


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_data_that_are_not_finite_have_no_usable_answer_and_do_no_lasting_harm(bad):
    mpc = make_mpc(1, 5, 5, -3.0)
    good = (np.array([0.5, 0.0, 0.5]), 0.5, np.full(5, 0.7))
    expected = make_mpc(1, 5, 5, -3.0).solve(*good).input
    solution = mpc.solve(np.array([bad, 0.0, 0.5]), 0.5, np.full(5, 0.7))
    assert solution.input is None
    assert solution.status != "solved"
    assert mpc.solve(*good).input == pytest.approx(expected, abs=1e-4)


def test_a_solver_without_time_to_converge_says_so(monkeypatch):
    monkeypatch.setitem(mpc_module.SOLVER_SETTINGS, "max_iter", 1)
    solution = make_mpc(1, 5, 5, -3.0).solve(np.array([0.5, 0.0, 0.5]), 0.5, np.full(5, 0.7))
    assert solution.input is None
    assert "max" in solution.status
