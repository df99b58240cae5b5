"""The controller's settings are judged as a whole."""

from dataclasses import asdict

import pytest

from feed_axis_common.errors import SettingsError
from feed_axis_common.parameters import specifications
from mpc_controller.settings import ControllerSettings, default_settings


def test_defaults_are_the_hand_tuned_controller_of_the_scenario():
    settings = asdict(default_settings())
    expected = {
        "control_horizon": 15,
        "prediction_horizon": 15,
        "lambda_mpc": -3.0,
        "lambda_kf": -1.0,
        "gain": 1.0,
        "damping_ratio": 1.0,
        "natural_frequency": 26.0,
        "dead_time": 0.02,
        "sample_time": 0.02,
        "measurement_variance": 0.001,
        "input_lower": 0.0,
        "input_upper": 1.2,
    }
    assert {name: settings[name] for name in expected} == expected


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (
            {"prediction_horizon": 14},
            "prediction_horizon: 14 is below control_horizon 15; it must be at least as long",
        ),
        (
            {"control_horizon": 16},
            "prediction_horizon: 15 is below control_horizon 16; it must be at least as long",
        ),
        ({"input_upper": 0.0}, "input_upper: 0.0 is not above input_lower 0.0 m/s"),
        ({"input_lower": 2.0}, "input_upper: 1.2 is not above input_lower 2.0 m/s"),
        ({"dead_time": 2.01}, "dead_time: 2.01 is above 100 sample times of 0.02 s"),
        ({"return_time": "guessed"}, "return_time: 'guessed' is not one of measured, modelled"),
    ],
)
def test_rules_between_parameters(controller_settings, changes, message):
    with pytest.raises(SettingsError) as caught:
        controller_settings(**changes)
    assert str(caught.value) == message


def test_a_pair_that_is_right_only_together_is_accepted(controller_settings):
    settings = controller_settings(control_horizon=20, prediction_horizon=25)
    assert (settings.control_horizon, settings.prediction_horizon) == (20, 25)


@pytest.mark.parametrize("spec", specifications(ControllerSettings), ids=lambda spec: spec.name)
def test_every_parameter_is_described(spec):
    assert spec.text
    if spec.kind in (int, float):
        assert spec.lower is not None
        assert spec.upper is not None
        assert spec.lower < spec.upper


@pytest.mark.parametrize("spec", specifications(ControllerSettings), ids=lambda spec: spec.name)
def test_every_limit_is_enforced(controller_settings, spec):
    if spec.kind not in (int, float):
        return
    for beyond in (spec.lower - 1, spec.upper + 1):
        with pytest.raises(SettingsError, match=f"^{spec.name}: .* limit"):
            controller_settings(**{spec.name: spec.kind(beyond)})
