"""The lag of a signal, against a closed form and SciPy's correlation."""

import numpy as np
import pytest
from scipy.signal import correlate, correlation_lags

from bo_tuner.numerics.correlation import lag


@pytest.mark.parametrize("shift", [0.0, 0.3, 4.0, -7.6, 12.45])
def test_a_sum_of_sines(shift):
    """Another level and size are no matter; a fraction is found to within a thousandth."""

    def signal(k):
        return np.sin(0.11 * k) + 0.5 * np.sin(0.29 * k + 1.0)

    k = np.arange(600.0)
    assert lag(3.0 * signal(k - shift) + 8.0, signal(k), 20) == pytest.approx(shift, abs=2e-3)


def test_noise_is_where_scipy_finds_it():
    rng = np.random.default_rng(3)
    noise = rng.normal(size=700)
    early, late = noise[50:], noise[43:-7] + rng.normal(0.0, 0.5, 650)
    lags = correlation_lags(650, 650)
    expected = lags[np.argmax(correlate(late, early))]
    assert expected == 7
    # The true peak is a sample wide, and so is the parabola.
    assert lag(late, early, 30) == pytest.approx(expected, abs=0.1)


def test_the_ends_of_a_range():
    k = np.arange(200.0)
    assert lag(np.sin(0.05 * (k - 9)), np.sin(0.05 * k), 5) == 5.0
    assert np.isnan(lag(np.ones(200), np.sin(0.05 * k), 5))
