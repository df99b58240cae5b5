"""What `check` says of its test runs."""

import math

import pytest
from functions import make_study

from bo_tuner.cli.test_runs import far_off


@pytest.mark.parametrize(
    ("limit", "values", "said"),
    [
        # 0.036 rad are 2 degrees.
        (7.0, (0.036, 0.036), "194 times what the default reaches, 0.036"),
        (math.radians(2.0), (2.0, 2.0, 2.1), "1/57.3 of what the default reaches, 2"),
        (1.0, (0.06, 0.06), ""),
        (1.0, (19.0, 19.0), ""),
        (1.0, (0.0, 0.0), ""),
        (0.0, (5.0, 5.0), ""),
        (-30.0, (1.0, 1.0), "30 times"),
    ],
)
def test_a_limit_far_from_the_default_may_be_in_another_unit(limit, values, said):
    limits = {"peak": {"kind": "worst_case", "metric": "peak", "upper": limit}}
    constraint = make_study(constraints=limits).constraints["peak"]
    text = far_off(constraint, "rad", values)
    assert bool(text) == bool(said)
    assert said in text
    assert not said or text.endswith("is it in rad?")
