"""The discretization against scipy and finely sampled simulations."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.signal import cont2discrete
from second_order import delayed_response, matrices

from feed_axis_common.errors import SettingsError
from feed_axis_common.model import (
    MOST_PAST_INPUTS,
    check_dead_time,
    delay_augmented,
    disturbance_augmented,
    feed_axis,
    split_dead_time,
    zero_order_hold,
)

SAMPLE_TIME = 0.02


@pytest.mark.parametrize("inputs", [1, 2])
@pytest.mark.parametrize("states", [1, 2, 4])
def test_zero_order_hold_agrees_with_scipy(states, inputs):
    rng = np.random.default_rng(states * 10 + inputs)
    A = rng.normal(size=(states, states))
    B = rng.normal(size=(states, inputs))
    Phi, Gamma = zero_order_hold(A, B, 0.3)
    expected, expected_input, *_ = cont2discrete(
        (A, B, np.eye(states), np.zeros((states, inputs))), 0.3
    )
    np.testing.assert_allclose(Phi, expected, rtol=1e-12, atol=1e-14)
    np.testing.assert_allclose(Gamma, expected_input, rtol=1e-12, atol=1e-14)


def test_zero_order_hold_over_no_time_changes_nothing():
    A, B = feed_axis(1.0, 0.7, 26.0)
    Phi, Gamma = zero_order_hold(A, B, 0.0)
    np.testing.assert_array_equal(Phi, np.eye(2))
    np.testing.assert_array_equal(Gamma, np.zeros((2, 1)))


def test_zero_order_hold_of_an_integrator_chain_is_a_polynomial():
    A = np.array([[0.0, 1.0], [0.0, 0.0]])
    B = np.array([[0.0], [1.0]])
    Phi, Gamma = zero_order_hold(A, B, 0.5)
    np.testing.assert_allclose(Phi, [[1.0, 0.5], [0.0, 1.0]], rtol=1e-14)
    np.testing.assert_allclose(Gamma, [[0.125], [0.5]], rtol=1e-14)


def test_feed_axis_has_the_transfer_function_of_the_paper():
    gain, damping, frequency, s = 1.7, 0.4, 26.0, 3.0 + 11.0j
    A, B = feed_axis(gain, damping, frequency)
    transfer = np.linalg.solve(s * np.eye(2) - A, B)[0, 0]
    assert transfer == pytest.approx(
        gain * frequency**2 / (s**2 + 2 * damping * frequency * s + frequency**2), rel=1e-12
    )


@pytest.mark.parametrize("damping", [0.3, 1.0, 2.5])
@pytest.mark.parametrize("delay", [0.0, 0.3, 0.95, 1.0, 1.5, 2.0, 3.0, 3.05])
def test_delay_augmented_agrees_with_a_finely_sampled_simulation(delay, damping):
    model = delay_augmented(*feed_axis(1.3, damping, 26.0), SAMPLE_TIME, delay * SAMPLE_TIME)
    commands = np.random.default_rng(1).normal(size=40)
    x = np.zeros((model.A.shape[0], 1))
    outputs = [0.0]
    for u in commands:
        x = model.A @ x + model.B * u
        outputs.append((model.C @ x).item())
    expected = delayed_response(
        matrices(1.3, damping, 26.0), commands, SAMPLE_TIME, delay * SAMPLE_TIME
    )
    np.testing.assert_allclose(outputs, expected, atol=1e-11)


@pytest.mark.parametrize(
    ("delay", "past_inputs"), [(0.0, 0), (0.3, 1), (1.0, 1), (1.5, 2), (3.0, 3)]
)
def test_the_past_inputs_that_still_act_are_states(delay, past_inputs):
    model = delay_augmented(*feed_axis(1.0, 1.0, 26.0), SAMPLE_TIME, delay * SAMPLE_TIME)
    assert model.axis_states == 2
    assert model.A.shape == (2 + past_inputs, 2 + past_inputs)
    assert model.B.shape == (2 + past_inputs, 1)
    assert model.C.shape == (1, 2 + past_inputs)


@pytest.mark.parametrize("delay", [0.0, 0.3, 1.0, 2.5])
def test_equilibrium_stays_where_it_is(delay):
    gain = 2.0
    model = delay_augmented(*feed_axis(gain, 0.8, 26.0), SAMPLE_TIME, delay * SAMPLE_TIME)
    x = model.equilibrium(0.6, gain)
    np.testing.assert_allclose(model.A @ x + model.B[:, 0] * 0.6 / gain, x, atol=1e-14)
    assert (model.C @ x).item() == 0.6


@pytest.mark.parametrize("delay", [0.0, 0.3, 1.0, 2.5])
def test_a_disturbance_acts_as_an_input_without_dead_time(delay):
    axis = feed_axis(1.3, 0.8, 26.0)
    plain = delay_augmented(*axis, SAMPLE_TIME, delay * SAMPLE_TIME)
    model = disturbance_augmented(plain, zero_order_hold(*axis, SAMPLE_TIME)[1])
    assert (model.axis_states, model.disturbance) == (3, 2)
    commands, load = np.random.default_rng(1).normal(size=40), 0.7
    x = np.zeros((model.A.shape[0], 1))
    x[model.disturbance] = load
    outputs = [0.0]
    for u in commands:
        x = model.A @ x + model.B * u
        outputs.append((model.C @ x).item())
    assert x[model.disturbance] == load
    system = matrices(1.3, 0.8, 26.0)
    expected = delayed_response(system, commands, SAMPLE_TIME, delay * SAMPLE_TIME)
    expected += delayed_response(system, np.full(40, load), SAMPLE_TIME, 0.0)
    np.testing.assert_allclose(outputs, expected, atol=1e-11)


def test_the_equilibrium_is_without_a_disturbance():
    axis = feed_axis(2.0, 0.8, 26.0)
    plain = delay_augmented(*axis, SAMPLE_TIME, 1.5 * SAMPLE_TIME)
    model = disturbance_augmented(plain, zero_order_hold(*axis, SAMPLE_TIME)[1])
    x = model.equilibrium(0.6, 2.0)
    np.testing.assert_array_equal(np.delete(x, model.disturbance), plain.equilibrium(0.6, 2.0))
    assert x[model.disturbance] == 0.0


@given(
    multiple=st.floats(0, 100, allow_subnormal=False),
    sample_time=st.floats(1e-5, 10),
)
def test_dead_time_is_split_into_samples_and_a_rest(multiple, sample_time):
    dead_time = multiple * sample_time
    d, tau = split_dead_time(dead_time, sample_time)
    if d == 0:
        assert tau == 0.0
        assert dead_time <= 1e-9 * sample_time
    else:
        assert 0.0 < tau <= sample_time
        assert (d - 1) * sample_time + tau == pytest.approx(dead_time, abs=2e-9 * sample_time)


@pytest.mark.parametrize("d", range(1, 101))
def test_a_whole_number_of_samples_is_not_split_by_rounding(d):
    # 0.3 / 0.1 is not 3 in floating point.
    for sample_time in (0.1, 0.02, 0.001, 1 / 3):
        for dead_time in (d * sample_time, sum([sample_time] * d)):
            found, tau = split_dead_time(dead_time, sample_time)
            assert found == d
            assert tau == pytest.approx(sample_time, rel=1e-7)


def test_as_many_past_inputs_as_allowed_are_not_refused_for_rounding():
    # 100 * 0.0007 is below 0.07 in floating point.
    for sample_time in (0.0007, 0.02, 1 / 3):
        most = MOST_PAST_INPUTS * sample_time
        for dead_time in (most, round(most, 9), sum([sample_time] * MOST_PAST_INPUTS)):
            check_dead_time(dead_time, sample_time)
        with pytest.raises(SettingsError, match="above 100 sample times"):
            check_dead_time(most + 0.01 * sample_time, sample_time)
