"""A cut: metrics by their definitions, noise, ends, and other plants than the shipped one."""

import itertools
import math

import numpy as np
import pytest
from cuts import Constant
from hypothesis import given
from hypothesis import strategies as st

from feed_axis_common.errors import SettingsError
from milling_plant.cut import (
    Cut,
    MillingPlant,
    effort,
    overshoot,
    reference_velocity,
    tracking_error,
)
from mpc_controller.controller import MpcController

velocities = st.floats(-2.0, 2.0, allow_subnormal=False)


def naive_overshoot(reference, velocity, window):
    n, worst = len(reference), 0.0
    for k in range(n):
        ceiling = max(reference[j] for j in range(n) if abs(j - k) <= window)
        worst = max(worst, velocity[k] - ceiling)
    return worst


@given(
    pairs=st.lists(st.tuples(velocities, velocities), min_size=1, max_size=30),
    window=st.integers(0, 40),
)
def test_overshoot_is_its_definition(pairs, window):
    reference, velocity = np.array(pairs).T
    assert overshoot(reference, velocity, window) == naive_overshoot(reference, velocity, window)


def test_a_late_step_down_is_no_overshoot():
    reference = np.repeat([0.8, 0.5], 20)
    late = np.repeat([0.8, 0.5], [25, 15])
    assert overshoot(reference, late, 5) == 0.0
    later = np.repeat([0.8, 0.5], [26, 14])
    assert overshoot(reference, later, 5) == pytest.approx(0.3)


@given(st.lists(st.tuples(velocities, velocities), min_size=1, max_size=30))
def test_tracking_error_is_the_sum_of_squares(pairs):
    reference, velocity = np.array(pairs).T
    expected = math.fsum((r - v) ** 2 for r, v in pairs)
    assert tracking_error(reference, velocity) == pytest.approx(expected, rel=1e-12, abs=1e-15)


@given(st.integers(0, 2**32), st.integers(1, 300), st.integers(0, 40))
def test_rows_score_what_they_score_alone(seed, samples, window):
    rng = np.random.default_rng(seed)
    reference, rows = rng.normal(size=samples), rng.normal(size=(7, samples))
    assert list(tracking_error(reference, rows)) == [tracking_error(reference, v) for v in rows]
    assert list(overshoot(reference, rows, window)) == [
        overshoot(reference, v, window) for v in rows
    ]


def test_effort_is_the_total_variation_of_the_command():
    # Up by 0.3, down by 0.5, and no move.
    assert effort(np.array([0.2, 0.5, 0.0, 0.0])) == pytest.approx(0.8, rel=1e-12)


def test_the_effort_is_that_of_the_commands_of_the_cut():
    plant = MillingPlant()
    result = plant.run_cut(MpcController())
    (_, commands) = plant.trace()["command"]
    total = math.fsum(abs(b - a) for a, b in itertools.pairwise(commands))
    # Not to the last bit: the order in which numpy adds is that of the processor's vector units.
    assert result["effort"] == pytest.approx(total, rel=1e-12)
    assert plant.run_cut(Constant(0.5))["effort"] == 0.0


def test_reference_holds_each_level(plant_settings):
    settings = plant_settings(reference_levels=[0.1, -0.2, 0.3], samples_per_level=2)
    np.testing.assert_array_equal(reference_velocity(settings), [0.1, 0.1, -0.2, -0.2, 0.3, 0.3])


def test_the_scenario_has_270_samples(plant_settings):
    assert reference_velocity(plant_settings()).size == 270


def test_the_error_of_an_axis_that_never_moves_is_that_of_the_levels():
    plant = MillingPlant()
    result = plant.run_cut(Constant(0.5))
    expected = 45 * (0.35**2 + 0.26**2 + 0.18**2)
    assert result["tracking_error"] == pytest.approx(expected, rel=1e-12)
    assert result["overshoot"] == pytest.approx(0.0, abs=1e-12)
    np.testing.assert_allclose(plant.velocity, 0.5, atol=1e-12)


def test_metrics_are_those_of_the_true_velocity(plant_settings):
    plant = MillingPlant(plant_settings(noise_variance=1.0, stiffness_factor=1.2))
    result = plant.run_cut(MpcController())
    reference = reference_velocity(plant.settings)
    assert plant.velocity.shape == reference.shape
    assert result["tracking_error"] == tracking_error(reference, plant.velocity)
    assert result["overshoot"] == naive_overshoot(reference, plant.velocity, 5)


def test_the_result_names_context_and_seed(plant_settings):
    plant = MillingPlant(plant_settings(stiffness_factor=1.3, damping_factor=0.7, seed=2**63 - 1))
    result = plant.run_cut(MpcController())
    assert result["status"] == "ok"
    assert result["reason"] == ""
    assert result["stiffness_factor"] == 1.3
    assert result["damping_factor"] == 0.7
    assert result["seed"] == 2**63 - 1
    assert result["samples"] == 270


def noise_of(plant):
    listener = Constant(0.5)
    plant.run_cut(listener)
    return np.array(listener.measurements) - plant.velocity


def test_noise_comes_back_with_its_seed(plant_settings):
    plant = MillingPlant(plant_settings(seed=7))
    first = noise_of(plant)
    np.testing.assert_array_equal(noise_of(plant), first)
    np.testing.assert_array_equal(noise_of(MillingPlant(plant_settings(seed=7))), first)
    other = noise_of(MillingPlant(plant_settings(seed=8)))
    assert abs(np.corrcoef(first, other)[0, 1]) < 0.3


def test_noise_does_not_depend_on_the_context(plant_settings):
    nominal = noise_of(MillingPlant(plant_settings(seed=7)))
    corner = MillingPlant(plant_settings(seed=7, stiffness_factor=1.3, damping_factor=0.7))
    np.testing.assert_allclose(noise_of(corner), nominal, atol=1e-12)


@pytest.mark.parametrize("variance", [1e-6, 0.001, 2.0])
def test_noise_is_white_and_gaussian_with_the_stated_variance(plant_settings, variance):
    settings = plant_settings(
        noise_variance=variance, reference_levels=[0.5], samples_per_level=20_000, seed=3
    )
    noise = noise_of(MillingPlant(settings)) / math.sqrt(variance)
    n = noise.size
    # Four standard deviations of the sample moments of a normal distribution.
    assert noise.mean() == pytest.approx(0.0, abs=4 / math.sqrt(n))
    assert noise.var() == pytest.approx(1.0, abs=4 * math.sqrt(2 / n))
    assert np.mean(noise**4) == pytest.approx(3.0, abs=4 * math.sqrt(96 / n))
    assert np.mean(noise[1:] * noise[:-1]) == pytest.approx(0.0, abs=4 / math.sqrt(n))


def test_without_noise_the_measurement_is_the_velocity(plant_settings):
    plant = MillingPlant(plant_settings(noise_variance=0.0, stiffness_factor=0.8))
    listener = Constant(0.7)
    plant.run_cut(listener)
    np.testing.assert_array_equal(listener.measurements, plant.velocity)


@pytest.mark.parametrize("command", [math.nan, math.inf, -math.inf])
def test_a_command_that_is_not_finite_fails_the_cut(command):
    result = MillingPlant().run_cut(Constant(command))
    assert result["status"] == "failed"
    assert result["reason"] == f"command of sample 0 is {command}"
    assert result["samples"] == 0
    assert "tracking_error" not in result
    assert "overshoot" not in result


def test_a_cut_that_diverges_fails():
    plant = MillingPlant()
    result = plant.run_cut(Constant(1e4))
    assert result["status"] == "failed"
    assert result["reason"].endswith("the loop diverged")
    assert "tracking_error" not in result
    assert np.isfinite(plant.velocity).all()


@pytest.mark.parametrize("command", [1e308, -1e308])
def test_an_overflow_fails_the_cut(plant_settings, command):
    plant = MillingPlant(plant_settings(gain=1e6))
    with np.errstate(over="ignore", invalid="ignore"):
        result = plant.run_cut(Constant(command))
    assert result["status"] == "failed"
    assert "the loop diverged" in result["reason"]


def test_a_speed_at_the_limit_is_no_divergence(plant_settings):
    settings = plant_settings(velocity_limit=0.5, reference_levels=[0.5])
    assert MillingPlant(settings).run_cut(Constant(0.49))["status"] == "ok"


def test_a_cut_waits_for_its_commands(plant_settings):
    cut = Cut(plant_settings(reference_levels=[0.5, 0.6], samples_per_level=3))
    for k in range(6):
        assert not cut.done
        assert cut.sample == k
        assert cut.measurement == cut.measurement
        assert cut.velocity.size == k + 1
        assert "tracking_error" not in cut.result()
        cut.apply(0.55)
    assert cut.done
    assert cut.velocity.size == 6
    assert cut.result()["status"] == "ok"


def test_a_cut_that_was_ended_from_outside_has_no_metrics(plant_settings):
    cut = Cut(plant_settings())
    cut.apply(0.5)
    cut.fail("no command")
    assert cut.done
    result = cut.result()
    assert (result["status"], result["reason"], result["samples"]) == ("failed", "no command", 1)
    assert "tracking_error" not in result


def test_another_command_for_a_sample_disturbs_the_cut(plant_settings):
    settings = plant_settings(reference_levels=(0.5,), samples_per_level=3)
    cut = Cut(settings)
    for command in (0.4, 0.5, 0.6):
        assert not cut.contradicted(cut.sample, 9.0)  # it waits for its first one
        cut.apply(command)
    for sample, command in ((0, 0.4), (2, 0.6), (-1, 9.0), (3, 9.0)):
        assert not cut.contradicted(sample, command)
    assert cut.result()["status"] == "ok"
    assert cut.contradicted(1, 0.4)
    assert not cut.contradicted(2, 0.4)  # it is known already
    result = cut.result()
    assert (result["status"], "tracking_error" in result) == ("disturbed", False)
    assert result["reason"] == (
        "sample 1 has two commands, 0.5 and 0.4 m/s; does a second controller run?"
    )


def test_plant_parameters_change_all_or_none():
    plant = MillingPlant()
    before = plant.settings
    with pytest.raises(SettingsError, match="seed: -1 is below"):
        plant.set_parameters({"stiffness_factor": 1.1, "seed": -1})
    assert plant.settings is before
    plant.set_parameters({"stiffness_factor": 1.1, "seed": 4})
    assert (plant.settings.stiffness_factor, plant.settings.seed) == (1.1, 4)


def test_the_same_cut_comes_back_bit_for_bit(plant_settings):
    plant, controller = MillingPlant(plant_settings(seed=1, damping_factor=0.8)), MpcController()
    first = plant.run_cut(controller)
    trajectory = plant.velocity
    plant.set_parameters({"seed": 2})
    assert plant.run_cut(controller)["tracking_error"] != first["tracking_error"]
    plant.set_parameters({"seed": 1})
    assert plant.run_cut(controller) == first
    np.testing.assert_array_equal(plant.velocity, trajectory)


AXIS = ("gain", "damping_ratio", "natural_frequency", "dead_time", "sample_time")


@pytest.mark.parametrize(
    ("axis", "levels", "limits"),
    [
        ((1.0, 1.0, 26.0, 0.0, 0.02), [0.5, 0.8], (0.0, 1.2)),
        ((1.0, 1.0, 26.0, 0.013, 0.02), [0.5, 0.8], (0.0, 1.2)),
        ((1.0, 0.3, 26.0, 0.06, 0.02), [0.5, 0.8], (0.0, 1.2)),
        ((2.5, 0.7, 60.0, 0.0125, 0.005), [-1.0, 1.0, 0.0], (-2.0, 2.0)),
        ((0.2, 1.8, 4.0, 0.25, 0.1), [0.1, 0.15], (0.0, 3.0)),
        ((1.0, 0.05, 100.0, 0.001, 0.001), [0.0, 0.01], (-0.1, 0.1)),
    ],
)
def test_other_axes_and_trajectories_give_a_stable_loop(
    plant_settings, controller_settings, axis, levels, limits
):
    """Without noise and mismatch the axis settles on each level."""
    constants = dict(zip(AXIS, axis, strict=True))
    samples = 150
    plant = MillingPlant(
        plant_settings(
            **constants,
            reference_levels=levels,
            samples_per_level=samples,
            noise_variance=0.0,
        )
    )
    controller = MpcController(
        controller_settings(
            **constants,
            input_lower=limits[0],
            input_upper=limits[1],
            control_horizon=10,
            prediction_horizon=20,
            lambda_mpc=-2.0,
        )
    )
    result = plant.run_cut(controller)
    assert result["status"] == "ok"
    assert controller.cut_result()["status"] == "ok"
    settled = plant.velocity.reshape(len(levels), samples)[:, samples // 2 : -20]
    span = max(levels) - min(levels)
    np.testing.assert_allclose(
        settled, np.broadcast_to(np.array(levels)[:, None], settled.shape), atol=0.02 * span
    )


class TestEndBeyond:
    def whole(self, controller):
        return MillingPlant().run_cut(controller)

    @pytest.mark.parametrize("metric", ["tracking_error", "overshoot", "effort"])
    def test_a_cut_ends_as_soon_as_a_metric_is_beyond(self, metric):
        whole = self.whole(MpcController())
        plant = MillingPlant()
        plant.end_beyond({metric: 0.5 * whole[metric]})
        cut = plant.run_cut(MpcController())
        assert cut["status"] == "cut short"
        assert cut[metric] > 0.5 * whole[metric]
        assert cut["after"] == pytest.approx(plant.settings.sample_time * cut["samples"])
        assert cut["samples"] < whole["samples"]
        for name in ("tracking_error", "overshoot", "effort"):
            assert 0.0 <= cut[name] <= whole[name] * (1.0 + 1e-12)
        assert all(len(values) == cut["samples"] for _, values in plant.trace().values())

    def test_one_that_stays_within_is_the_same_as_ever(self):
        whole = self.whole(MpcController())
        plant = MillingPlant()
        plant.end_beyond({"overshoot": whole["overshoot"], "effort": whole["effort"]})
        assert plant.run_cut(MpcController()) == whole
        plant.end_beyond({"effort": 0.5 * whole["effort"]})
        assert plant.run_cut(MpcController())["status"] == "cut short"
        plant.end_beyond({})
        assert plant.run_cut(MpcController()) == whole
