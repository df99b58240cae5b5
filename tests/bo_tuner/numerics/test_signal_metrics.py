"""Numbers of signals, against python-control's step_info and against closed forms."""

import math

import control
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bo_tuner.numerics import signal_metrics as metrics
from bo_tuner.numerics.signal_metrics import MEASURES, UndefinedMetricError, options_of

# A held signal: 2 from 1 s to 2 s, -1 to 4 s, 3 to 4.5 s.
TIME = np.array([1.0, 2.0, 4.0, 4.5])
VALUE = np.array([2.0, -1.0, 3.0, 3.0])


@pytest.mark.parametrize(
    ("samples", "period", "percent"),
    [(10, 0.01, 90.0), (1000, 0.001, 99.0), (300_000, 0.001, 99.0)],
)
def test_percentiles_do_not_depend_on_the_order(samples, period, percent):
    """In 10 samples of equal length the ninth is not exceeded in 90 % of the time."""
    rng = np.random.default_rng(0)
    values = np.arange(1.0, samples + 1.0)
    for shuffled in (values, *(rng.permutation(values) for _ in range(20))):
        time = period * np.arange(samples + 1)
        found = metrics.percentile(time, np.append(shuffled, 0.0), percent=percent)
        assert found == samples * percent / 100.0


@pytest.mark.parametrize(
    ("measure", "expected"),
    [
        ("iae", 2 * 1 + 1 * 2 + 3 * 0.5),
        ("ise", 4 * 1 + 1 * 2 + 9 * 0.5),
        # With time from the first sample on: 2 t over [0, 1], t over [1, 3], 3 t over [3, 3.5].
        ("itae", 2 * 0.5 + (9 - 1) / 2 + 3 * (3.5**2 - 9) / 2),
        ("rms", math.sqrt(10.5 / 3.5)),
        ("mean", (2 - 2 + 1.5) / 3.5),
        # The mean of the squares less the square of the mean.
        ("std", math.sqrt(10.5 / 3.5 - (1.5 / 3.5) ** 2)),
        ("minimum", -1.0),
        ("maximum", 3.0),
        ("total_variation", 3 + 4),
        ("total_variation_rate", (3 + 4) / 3.5),
        ("largest_rate", 3 / 1),
        ("largest_gap", 2.0),
        ("duration", 3.5),
    ],
)
def test_a_held_signal_by_hand(measure, expected):
    assert MEASURES[measure](TIME, VALUE) == pytest.approx(expected, rel=1e-14)


@pytest.mark.parametrize("period", [0.02, 0.1, 0.3])
def test_a_mean_is_none_beyond_the_values(period):
    """The sum of the products of 1 and the widths is rounded otherwise than the duration."""
    for count in range(2, 1000):
        time = 1.7e9 + period * np.arange(count)
        assert metrics.mean(time - time[0], np.ones(count)) == 1.0
        assert metrics.mean(np.cumsum(np.full(count, period)), np.ones(count)) == 1.0


@pytest.mark.parametrize(
    ("percent", "expected"), [(0, -1), (57, -1), (58, 2), (85, 2), (86, 3), (100, 3)]
)
def test_percentiles_count_time_and_not_samples(percent, expected):
    # -1 during 2 of 3.5 s (57.1 %), at most 2 during 3 s (85.7 %).
    assert metrics.percentile(TIME, VALUE, percent=percent) == expected


def test_integrals_of_a_decaying_error():
    """Of exp(-t): 1, 1/2 and 1, up to the tail and to the width of a sample."""
    time = np.linspace(0.0, 30.0, 300_001)
    value = np.exp(-time)
    assert metrics.iae(time, value) == pytest.approx(1.0, abs=1e-4)
    assert metrics.ise(time, value) == pytest.approx(0.5, abs=1e-4)
    assert metrics.itae(time, value) == pytest.approx(1.0, abs=1e-4)


def test_a_sine():
    time = np.linspace(0.0, 4 * np.pi, 400_001)
    value = 3.0 * np.sin(time)
    assert metrics.rms(time, value) == pytest.approx(3.0 / math.sqrt(2.0), rel=1e-6)
    assert metrics.mean(time, value) == pytest.approx(0.0, abs=1e-6)
    assert metrics.total_variation(time, value) == pytest.approx(3.0 * 8, rel=1e-6)
    assert metrics.largest_rate(time, value) == pytest.approx(3.0, rel=1e-6)
    # |3 sin t| is below 3 sin(p pi / 2) for the share p of the time.
    found = metrics.percentile(time, np.abs(value), percent=50.0)
    assert found == pytest.approx(3.0 * math.sin(math.pi / 4), rel=1e-4)


@pytest.mark.parametrize("damping", [0.15, 0.4, 0.7, 1.2])
@pytest.mark.parametrize("target", [1.0, -2.5, 40.0])
def test_steps_as_python_control_sees_them(damping, target):
    system = control.tf([9.0], [1.0, 6.0 * damping, 9.0])
    time, value = control.step_response(system, np.linspace(0.0, 30.0, 6001))
    value = target * value
    info = control.step_info(value, time, yfinal=target)
    assert metrics.overshoot(time, value, target=target) == pytest.approx(
        info["Overshoot"], rel=1e-9, abs=1e-9
    )
    assert metrics.rise_time(time, value, target=target) == pytest.approx(info["RiseTime"])
    assert metrics.settling_time(time, value, target=target) == pytest.approx(info["SettlingTime"])
    wide = control.step_info(value, time, yfinal=target, SettlingTimeThreshold=0.1)
    found = metrics.settling_time(time, value, target=target, band=0.1)
    assert found == pytest.approx(wide["SettlingTime"])
    # A step from elsewhere, later on: only its own size counts.
    for measure in ("overshoot", "rise_time", "settling_time"):
        moved = MEASURES[measure](time + 7.0, value + 5.0, target=target + 5.0)
        assert moved == pytest.approx(MEASURES[measure](time, value, target=target), abs=1e-6)


def test_overshoot_of_a_second_order_system_is_the_textbook_s():
    """exp(-pi z / sqrt(1 - z²)), Franklin, Powell and Emami-Naeini, section 3.4."""
    z, time = 0.3, np.linspace(0.0, 20.0, 20_001)
    wd = math.sqrt(1 - z**2)
    value = 1 - np.exp(-z * time) * (np.cos(wd * time) + z / wd * np.sin(wd * time))
    expected = 100 * math.exp(-math.pi * z / wd)
    assert metrics.overshoot(time, value, target=1.0) == pytest.approx(expected, rel=1e-6)


def test_the_steady_state_is_the_last_tenth_of_the_time():
    time = np.array([0.0, 5.0, 9.5, 10.0])
    # From 9 s on: 0.5 s of 3 and 0.5 s of 4.
    value = np.array([0.0, 3.0, 4.0, 4.0])
    assert metrics.steady_state_error(time, value, target=5.0) == pytest.approx(1.5)
    assert metrics.steady_state_error(time, value, target=3.0) == pytest.approx(0.5)


@pytest.mark.parametrize(
    ("measure", "options", "value", "problem"),
    [
        ("settling_time", {"target": 1.0}, [0.0, 0.5, 0.9], "does not settle within 0.02"),
        ("rise_time", {"target": 1.0}, [0.0, 0.5, 0.8], "does not rise to 90 %"),
        (
            "overshoot",
            {"target": 1.0},
            [1.0, 2.0, 1.0],
            "begins at 1 with the target 1: that is no step",
        ),
    ],
)
def test_what_is_not_defined_says_so(measure, options, value, problem):
    with pytest.raises(UndefinedMetricError, match=problem):
        MEASURES[measure](np.arange(3.0), np.array(value), **options)


STEPS = pytest.mark.parametrize("measure", ["overshoot", "rise_time", "settling_time"])


@STEPS
@pytest.mark.parametrize("seed", range(20))
def test_noise_about_the_target_is_no_step(measure, seed):
    """Its first value is as far from the target as any other: what comes out would be chance."""
    value = 1.0 + 0.01 * np.random.default_rng(seed).standard_normal(200)
    value[0] = 1.01
    with pytest.raises(UndefinedMetricError, match=r"begins at 1\.01 with the target 1, beside a "):
        MEASURES[measure](0.01 * np.arange(200.0), value, target=1.0)


@STEPS
def test_a_motion_away_from_the_target_and_back_is_no_step(measure):
    """A run that began at its target up to 1e-4 would overshoot by 100 000 %."""
    time = np.linspace(0.0, 2.0, 20_001)
    value = 0.9999 + 0.1 * np.sin(np.pi * time / 2.0)
    with pytest.raises(UndefinedMetricError, match="that is no step"):
        MEASURES[measure](time, value, target=1.0)


@pytest.mark.parametrize("noise", [0.0, 0.01, 0.1])
@pytest.mark.parametrize("period", [0.001, 0.01, 0.1])
@pytest.mark.parametrize("damping", [0.05, 0.3, 1.5])
def test_a_step_in_noise_is_one(noise, period, damping):
    """Also of an oscillation that hardly decays, at some samples a period and at thousands."""
    time = np.arange(0.0, 20.0, period)
    system = control.tf([9.0], [1.0, 6.0 * damping, 9.0])
    _, value = control.step_response(system, time)
    value = value + noise * np.random.default_rng(1).standard_normal(len(time))
    expected = max(0.0, 100.0 * ((value.max() - value[0]) / (1.0 - value[0]) - 1.0))
    assert metrics.overshoot(time, value, target=1.0) == pytest.approx(expected, abs=1e-6)


def test_a_response_that_grows_overshoots():
    """Ten times the step: the parameters are bad, and that is a number."""
    time = np.linspace(0.0, 5.0, 51)
    value = 1.0 - np.exp(0.5 * time) * np.cos(4.0 * time)
    assert metrics.overshoot(time, value, target=1.0) > 500.0


@pytest.mark.parametrize(
    ("measure", "options"),
    [
        ("rms", {}),
        ("mean", {}),
        ("std", {}),
        ("total_variation_rate", {}),
        ("percentile", {"percent": 50}),
        ("steady_state_error", {"target": 1}),
    ],
)
def test_a_single_sample_has_no_duration(measure, options):
    with pytest.raises(UndefinedMetricError, match="no duration"):
        MEASURES[measure](np.array([3.0]), np.array([2.0]), **options)


def test_other_measures_of_a_single_sample():
    one = np.array([3.0]), np.array([2.0])
    assert [MEASURES[m](*one) for m in ("iae", "ise", "itae", "total_variation")] == [0] * 4
    assert [MEASURES[m](*one) for m in ("duration", "largest_gap")] == [0, 0]
    assert [MEASURES[m](*one) for m in ("minimum", "maximum")] == [2, 2]
    with pytest.raises(UndefinedMetricError, match="no two samples"):
        metrics.largest_rate(*one)


@given(
    widths=st.lists(st.floats(0.01, 5.0), min_size=2, max_size=20),
    data=st.data(),
    percent=st.floats(0.0, 100.0),
)
def test_a_held_value_may_be_split(widths, data, percent):
    """A further sample that repeats the value that holds changes no number but gap and rate."""
    time = np.cumsum(widths)
    finite = st.floats(-100.0, 100.0)
    value = np.array(data.draw(st.lists(finite, min_size=len(time), max_size=len(time))))
    index = data.draw(st.integers(1, len(time) - 1))
    between = 0.5 * (time[index - 1] + time[index])
    split = np.insert(time, index, between), np.insert(value, index, value[index - 1])
    for name in (
        "iae", "ise", "itae", "rms", "mean", "minimum", "maximum", "total_variation",
        "total_variation_rate",
    ):  # fmt: skip
        assert MEASURES[name](*split) == pytest.approx(MEASURES[name](time, value), abs=1e-9)
    # Of a root the rounding error is that of the square, not of itself.
    assert metrics.std(*split) ** 2 == pytest.approx(metrics.std(time, value) ** 2, abs=1e-9)
    low, high = (metrics.percentile(*split, percent=p) for p in (0.0, 100.0))
    assert low <= metrics.percentile(time, value, percent=percent) <= high


def test_the_options_of_the_measures():
    assert options_of("iae") == {}
    assert options_of("settling_time") == {"target": True, "band": False}
    assert options_of("percentile") == {"percent": True}
