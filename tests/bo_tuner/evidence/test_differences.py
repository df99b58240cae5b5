"""Differences against SciPy's tests of means, and in words."""

from math import inf, isinf

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from bo_tuner.evidence.differences import Change, Difference, paired, unpaired

samples = st.lists(st.floats(-1e3, 1e3).map(lambda v: round(v, 3)), min_size=2, max_size=30)


@given(st.lists(st.tuples(st.floats(-1e3, 1e3), st.floats(-1e3, 1e3)), min_size=2, max_size=30))
def test_pairs_are_as_in_the_paired_t_test(pairs):
    default, tuned = map(np.array, zip(*pairs, strict=True))
    if np.ptp(tuned - default) < 1e-6:
        return
    found = paired(default, tuned, np.empty((len(pairs), 0)))
    interval = stats.ttest_rel(tuned, default).confidence_interval(0.95)
    assert (found.low, found.high) == pytest.approx(tuple(interval), rel=1e-9, abs=1e-9)
    assert found.count == len(pairs)


@given(samples, samples)
def test_independent_means_are_as_in_welchs_test(default, tuned):
    if np.ptp(default) < 1e-6 or np.ptp(tuned) < 1e-6:
        return
    interval = stats.ttest_ind(tuned, default, equal_var=False).confidence_interval(0.95)
    of = [(np.mean(v), stats.sem(v), len(v)) for v in (default, tuned)]
    found = unpaired(*of)
    assert (found.low, found.high) == pytest.approx(tuple(interval), rel=1e-6, abs=1e-6)


@pytest.mark.parametrize("scale", [1e-85, 1e78])
def test_standard_errors_of_any_size(scale):
    one = unpaired((1.0, 0.5, 9), (3.0, 0.25, 20))
    found = unpaired((scale, 0.5 * scale, 9), (3.0 * scale, 0.25 * scale, 20))
    assert (found.low, found.high) == pytest.approx((one.low * scale, one.high * scale))


@pytest.mark.parametrize("count", [0, 1])
def test_too_few_pairs_show_nothing(count):
    found = paired([1.0] * count, [0.0] * count, np.empty((count, 0)))
    assert isinf(found.low)
    assert isinf(found.high)
    assert found.change(1.0) is Change.UNKNOWN


@pytest.mark.parametrize(
    ("low", "high", "sign", "change"),
    [
        (-2.0, -1.0, 1.0, Change.BETTER),
        (-2.0, -1.0, -1.0, Change.WORSE),
        (1.0, 2.0, 1.0, Change.WORSE),
        (1.0, 2.0, -1.0, Change.BETTER),
        (-2.0, -1.0, 0.0, Change.LOWER),
        (1.0, 2.0, 0.0, Change.HIGHER),
        (-1.0, 1.0, 1.0, Change.NONE),
        (0.0, 0.0, 1.0, Change.NONE),
        (-inf, inf, 1.0, Change.UNKNOWN),
    ],
)
def test_the_words_follow_the_interval_not_the_sign(low, high, sign, change):
    assert Difference(-0.5, low, high, 9).change(sign) is change


def test_what_rounding_leaves_of_cancelled_noise_is_no_interval():
    """The same noise in both: of their difference only the last digits vary."""
    noise = np.random.default_rng(1).standard_normal(25)
    found = paired(0.3 + noise, 0.1 + noise, np.empty((25, 0)))
    assert found.low == found.mean == found.high == pytest.approx(-0.2)
    same = paired(0.3 + noise, (0.1 + noise) + 0.2, np.empty((25, 0)))
    assert (same.mean, same.low, same.high) == (0.0, 0.0, 0.0)
    assert same.change(1.0) is Change.NONE
