"""The plant's settings are judged as a whole."""

import math

import pytest

from feed_axis_common.errors import SettingsError
from feed_axis_common.parameters import specifications
from milling_plant.settings import PlantSettings, default_settings


def test_defaults_are_the_scenario():
    s = default_settings()
    assert (s.gain, s.damping_ratio, s.natural_frequency) == (1.0, 1.0, 26.0)
    assert (s.dead_time, s.sample_time) == (0.02, 0.02)
    assert (s.stiffness_factor, s.damping_factor, s.noise_variance) == (1.0, 1.0, 0.001)
    assert s.reference_levels == (0.50, 0.85, 0.50, 0.76, 0.50, 0.68)
    assert (s.samples_per_level, s.overshoot_window) == (45, 5)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"seed": -1}, "seed: -1 is below the lower limit 0"),
        ({"seed": 1.0}, "seed: 1.0 is not an integer"),
        ({"stiffness_factor": math.nan}, "stiffness_factor: nan is not finite"),
        (
            {"noise_variance": -0.1},
            "noise_variance: -0.1 is below the lower limit 0 (m/s)^2",
        ),
        ({"reference_levels": ()}, "reference_levels: () is not a list of at least one number"),
        (
            {"samples_per_level": 100_000, "reference_levels": [0.5] * 11},
            "samples_per_level: a cut of 1100000 samples; expected at most 1000000",
        ),
        ({"dead_time": 2.1}, "dead_time: 2.1 is above 100 sample times of 0.02 s"),
    ],
)
def test_what_breaks_a_rule_is_refused(plant_settings, changes, message):
    with pytest.raises(SettingsError) as caught:
        plant_settings(**changes)
    assert str(caught.value) == message


@pytest.mark.parametrize(
    "spec",
    [spec for spec in specifications(PlantSettings) if spec.kind is not str],
    ids=lambda spec: spec.name,
)
def test_every_limit_is_enforced(plant_settings, spec):
    assert spec.lower < spec.upper
    for beyond in (spec.lower - 1, spec.upper * 2 + 1):
        value = [float(beyond)] if spec.kind is tuple else spec.kind(beyond)
        with pytest.raises(SettingsError, match=f"^{spec.name}: .* limit"):
            plant_settings(**{spec.name: value})
