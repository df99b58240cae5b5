"""The controller's settings are judged as a whole."""

from dataclasses import asdict

import numpy as np
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
        (
            {
                "estimate_disturbance": True,
                "damping_ratio": 0.0,
                "natural_frequency": 157.07963267948966,
            },
            "estimate_disturbance: natural_frequency 157.07963267948966 rad/s without damping is "
            "1 pi / sample_time, so that the samples do not show all states; expected another "
            "sample_time, or a damping_ratio above 0",
        ),
        (
            {"return_time": "guessed"},
            "return_time: 'guessed' is not one of measured, cpu, modelled",
        ),
    ],
)
def test_rules_between_parameters(controller_settings, changes, message):
    with pytest.raises(SettingsError) as caught:
        controller_settings(**changes)
    assert str(caught.value) == message


def test_a_pair_that_is_right_only_together_is_accepted(controller_settings):
    settings = controller_settings(control_horizon=20, prediction_horizon=25)
    assert (settings.control_horizon, settings.prediction_horizon) == (20, 25)


@pytest.mark.parametrize("damping_ratio", [0.0, 0.05, 1.0])
@pytest.mark.parametrize("phase", [0.1, 0.5, 1.0, 1.5, 2.0, 2.5, 3.0])
def test_a_disturbance_is_refused_where_the_rank_test_finds_it_undetectable(
    controller_settings, phase, damping_ratio
):
    """Popov, Belevitch and Hautus: all modes that do not decay must be seen. `phase` is of pi."""
    values = {"damping_ratio": damping_ratio, "natural_frequency": 50.0 * np.pi * phase}
    model = controller_settings(**values).model()
    A, C = np.zeros((3, 3)), np.array([[1.0, 0.0, 0.0]])
    A[:2, :2], A[2, 2] = model.A[:2, :2], 1.0
    # All of a constant input; with one sample of dead time the model has it as the past input's.
    A[:2, 2] = model.A[:2, 2]
    scale = np.diag([1.0, values["natural_frequency"], 1.0])
    A = np.linalg.inv(scale) @ A @ scale
    modes = [mode for mode in np.linalg.eigvals(A) if abs(mode) > 1.0 - 1e-9]
    detectable = all(
        np.linalg.matrix_rank(np.vstack([mode * np.eye(3) - A, C]), tol=1e-9) == 3 for mode in modes
    )
    assert detectable == (damping_ratio > 0.0 or phase % 1.0 != 0.0)
    if detectable:
        assert controller_settings(estimate_disturbance=True, **values).model().disturbance == 2
    else:
        with pytest.raises(SettingsError, match=r"^estimate_disturbance: .* sample_time"):
            controller_settings(estimate_disturbance=True, **values)


@pytest.mark.parametrize("spec", specifications(ControllerSettings), ids=lambda spec: spec.name)
def test_every_parameter_is_described(spec):
    assert spec.text
    if spec.kind in (int, float):
        assert spec.lower is not None
        assert spec.upper is not None
        assert spec.lower < spec.upper


@pytest.mark.parametrize(
    "spec",
    [spec for spec in specifications(ControllerSettings) if spec.kind in (int, float)],
    ids=lambda spec: spec.name,
)
def test_every_limit_is_enforced(controller_settings, spec):
    for beyond in (spec.lower - 1, spec.upper + 1):
        with pytest.raises(SettingsError, match=f"^{spec.name}: .* limit"):
            controller_settings(**{spec.name: spec.kind(beyond)})
