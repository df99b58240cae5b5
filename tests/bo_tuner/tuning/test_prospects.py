"""What models expect elsewhere, by models whose probability is known."""

from types import SimpleNamespace

import numpy as np
import pytest

from bo_tuner.codec.reading import JSON, read
from bo_tuner.tuning.prospects import Beyond, Prospects, prospects_in


def models(of):
    """Models that give a parameter set, by its coordinate, a probability."""
    return SimpleNamespace(feasibility=lambda x: of(x[:, 0]))


def test_the_largest_probability_within_the_bounds(make_study):
    """A narrow peak of 0.3 at 0.7."""
    found = prospects_in(make_study(), models(lambda x: 0.3 * np.exp(-(((x - 0.7) / 0.02) ** 2))))
    assert found.chance == pytest.approx(0.3, rel=0.01)
    assert found.beyond == ()


def test_a_range_counts_only_where_feasible_sets_are_expected_beyond(make_study):
    rising = prospects_in(make_study(), models(lambda x: np.clip(x - 0.7, 0.0, 1.0)))
    (beyond,) = rising.beyond
    assert (beyond.parameter, beyond.side) == ("gain", "upper")
    assert beyond.chance == pytest.approx(0.55)
    # Where feasible sets are expected within the bounds, nobody needs other ones.
    assert prospects_in(make_study(), models(lambda x: np.clip(x, 0.0, 1.0))).beyond == ()
    assert prospects_in(make_study(), models(lambda x: np.zeros(len(x)))) == Prospects(0.0)


def test_it_is_read_as_it_was_written():
    found = Prospects(0.1, (Beyond("gain", "upper", 0.6),))
    entry = {"chance": 0.1, "beyond": [{"parameter": "gain", "side": "upper", "chance": 0.6}]}
    assert read(Prospects, entry, JSON) == found
