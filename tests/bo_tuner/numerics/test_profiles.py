"""References over time, against closed forms and SciPy."""

import numpy as np
import pytest
import scipy.signal
from numpy.testing import assert_allclose

from bo_tuner.numerics import profiles

TIME = np.linspace(0.0, 5.0, 1001)


def test_a_step_is_there_at_its_time():
    assert profiles.step([0.0, 0.999, 1.0, 2.0], 3.0, 5.0, 1.0).tolist() == [3.0, 3.0, 5.0, 5.0]


def test_a_ramp_stays_before_and_after():
    time = [0.0, 1.0, 1.5, 3.0, 9.0]
    assert profiles.ramp(time, 2.0, -2.0, 1.0, 2.0) == pytest.approx([2.0, 2.0, 1.0, -2.0, -2.0])


def test_a_sine_has_its_period_and_phase():
    values = profiles.sine(TIME, 2.0, 0.5, 1.0, np.pi / 2)
    assert_allclose(values, 1.0 + 2.0 * np.cos(np.pi * TIME), atol=1e-12)


@pytest.mark.parametrize("sweep", ["linear", "logarithmic"])
@pytest.mark.parametrize("frequencies", [(0.2, 4.0), (4.0, 0.2), (1.0, 1.0)])
def test_a_chirp_is_that_of_scipy(sweep, frequencies):
    first, last = frequencies
    # A sine is a cosine a quarter of a turn later.
    expected = scipy.signal.chirp(TIME, first, 5.0, last, method=sweep, phi=-90)
    found = profiles.chirp(TIME, 3.0, frequencies, 5.0, 0.5, sweep == "logarithmic")
    assert_allclose(found, 0.5 + 3.0 * expected, atol=1e-9)


def test_a_chirp_stays_at_its_end():
    end, later = profiles.chirp([5.0, 9.0], 1.0, (0.1, 1.05), 5.0, 0.0, False)
    assert later == end != 0.0


def test_a_multisine_has_its_lines_in_the_spectrum():
    """Over a whole period, the discrete Fourier transform tells amplitude and phase of each."""
    time = np.arange(200) / 200.0
    values = profiles.multisine(time, [1.0, 0.5, 2.0], [1.0, 7.0, 20.0], [0.3, -1.0, 2.0], 0.25)
    lines = np.fft.rfft(values) / 100.0
    assert_allclose(np.abs(lines[[1, 7, 20]]), [1.0, 0.5, 2.0], atol=1e-12)
    # Of a sine, the line is a quarter of a turn behind its phase.
    assert_allclose(np.angle(lines[[1, 7, 20]] * 1j), [0.3, -1.0, 2.0], atol=1e-9)
    assert lines[0].real / 2.0 == pytest.approx(0.25)
    rest = np.delete(lines, [0, 1, 7, 20])
    assert_allclose(rest, 0.0, atol=1e-12)


def test_schroeder_phases_keep_the_peak_low():
    """Equal sines in phase peak at their sum; Schroeder's stay near that of a single sine."""
    time = np.arange(4096) / 4096.0
    frequencies = np.arange(1.0, 33.0)
    rms = np.sqrt(32 / 2)

    def crest(phases):
        values = profiles.multisine(time, np.ones(32), frequencies, phases, 0.0)
        return np.abs(values).max() / rms

    assert crest(profiles.schroeder_phases(32)) < 2.0 < 4.0 < crest(np.zeros(32))


def test_a_table():
    times, values = np.array([1.0, 2.0, 4.0]), np.array([10.0, 20.0, 0.0])
    time = [0.0, 1.5, 2.0, 3.0, 9.0]
    assert profiles.interpolated(time, times, values, False).tolist() == [10.0, 15, 20, 10, 0]
    assert profiles.interpolated(time, times, values, True).tolist() == [10.0, 10, 20, 20, 0]
