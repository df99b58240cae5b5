"""The axis against closed forms, a finely sampled simulation and the controller's model."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from second_order import delayed_response, matrices, step_response

from feed_axis_common.model import delay_augmented, feed_axis
from milling_plant.feed_axis import FeedAxis

SAMPLE_TIME = 0.02
DELAYS = [0.0, 0.3, 1.0, 1.5, 3.0]


def run(axis, commands):
    velocities = [axis.velocity]
    for u in commands:
        axis.step(float(u))
        velocities.append(axis.velocity)
    return np.array(velocities)


@pytest.mark.parametrize("delay", DELAYS)
@pytest.mark.parametrize("stiffness", [0.7, 1.0, 1.3])
@pytest.mark.parametrize("damping", [0.4, 1.0, 1.6])
def test_step_response_has_its_closed_form_in_every_context(
    plant_settings, damping, stiffness, delay
):
    """Under-, critically and over-damped, by the context's factors."""
    gain = 1.25
    settings = plant_settings(
        gain=gain,
        dead_time=delay * SAMPLE_TIME,
        stiffness_factor=stiffness,
        damping_factor=damping,
    )
    axis = FeedAxis(settings, velocity=0.5)
    velocities = run(axis, [0.8] * 60)
    t = np.arange(61) * SAMPLE_TIME - delay * SAMPLE_TIME
    change = gain * 0.8 - 0.5
    expected = 0.5 + change * step_response(t, damping, 26.0 * stiffness)
    np.testing.assert_allclose(velocities, expected, atol=1e-10)


@pytest.mark.parametrize("delay", [*DELAYS, 0.05, 2.95])
def test_any_commands_agree_with_a_finely_sampled_simulation(plant_settings, delay):
    settings = plant_settings(
        gain=1.5, damping_ratio=0.6, dead_time=delay * SAMPLE_TIME, damping_factor=0.5
    )
    commands = np.random.default_rng(4).normal(size=50)
    expected = delayed_response(
        matrices(1.5, 0.3, 26.0), commands, SAMPLE_TIME, delay * SAMPLE_TIME
    )
    # The fine simulation has no sample after the last command.
    velocities = run(FeedAxis(settings, 0.0), commands)
    np.testing.assert_allclose(velocities, expected, atol=1e-11)


@given(
    delay=st.floats(0.0, 5.0),
    damping=st.floats(0.0, 3.0),
    frequency=st.floats(1.0, 100.0),
    seed=st.integers(0, 100),
)
def test_nominal_axis_is_the_controllers_prediction(
    plant_settings, delay, damping, frequency, seed
):
    settings = plant_settings(
        damping_ratio=damping, natural_frequency=frequency, dead_time=delay * SAMPLE_TIME
    )
    model = delay_augmented(
        *feed_axis(settings.gain, damping, frequency), SAMPLE_TIME, settings.dead_time
    )
    commands = np.random.default_rng(seed).uniform(0.0, 1.2, 40)
    x = model.equilibrium(0.5, settings.gain)
    predicted = [0.5]
    for u in commands:
        x = model.A @ x + model.B[:, 0] * u
        predicted.append(x[0])
    np.testing.assert_allclose(run(FeedAxis(settings, 0.5), commands), predicted, atol=1e-9)


@pytest.mark.parametrize("delay", DELAYS)
def test_a_command_acts_only_after_the_dead_time(plant_settings, delay):
    axis = FeedAxis(plant_settings(dead_time=delay * SAMPLE_TIME), 0.5)
    velocities = run(axis, [1.2] * 10)
    whole = int(delay)
    np.testing.assert_allclose(velocities[: whole + 1], 0.5, atol=1e-12)
    assert velocities[whole + 1] > 0.5


@pytest.mark.parametrize("gain", [0.5, 3.0])
def test_rest_is_an_equilibrium(plant_settings, gain):
    axis = FeedAxis(plant_settings(gain=gain, dead_time=0.033, stiffness_factor=1.3), 0.6)
    np.testing.assert_allclose(run(axis, [0.6 / gain] * 20), 0.6, atol=1e-12)
