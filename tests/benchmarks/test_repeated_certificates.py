"""The parameter sets that are certified repeatedly break their limit in a ball of known size."""

import numpy as np
import pytest
from repeated_certificates import EXCESS, bumps


def test_where_the_limit_is_broken():
    found = list(bumps())
    assert len(found) == 36
    for bump in found:
        metric = bump.response
        assert metric.mean(metric.where[None])[0] == pytest.approx(1.0 + EXCESS)
        edge = metric.where + 0.5 * bump.violated * np.eye(bump.dimension)[0]
        assert metric.mean(edge[None])[0] == pytest.approx(1.0)
        assert ((metric.where > 0.0) & (metric.where < 1.0)).all()
