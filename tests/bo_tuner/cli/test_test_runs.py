"""What `check` says of its test runs."""

import math

import pytest
from functions import make_study

from bo_tuner.cli.test_runs import far_off


@pytest.mark.parametrize(
    ("limit", "values", "reached"),
    [
        # 0.036 rad are 2 degrees.
        (7.0, (0.036, 0.036), 0.036),
        (math.radians(2.0), (2.0, 2.0, 2.1), 2.0),
        (1.0, (0.06, 0.06), 0.0),
        (1.0, (19.0, 19.0), 0.0),
        (1.0, (0.0, 0.0), 0.0),
        (0.0, (5.0, 5.0), 0.0),
        (-30.0, (1.0, 1.0), 1.0),
    ],
)
def test_a_limit_far_from_the_default_may_be_in_another_unit(limit, values, reached):
    limits = {"peak": {"kind": "worst_case", "metric": "peak", "upper": limit}}
    constraint = make_study(constraints=limits).constraints["peak"]
    found = far_off(constraint, "rad", values)
    assert (found is not None) == bool(reached)
    assert found is None or found.reached == pytest.approx(reached)
