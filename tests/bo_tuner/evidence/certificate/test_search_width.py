"""Which violations the evaluated contexts meet, against closed forms."""

import math

import numpy as np
import pytest

from bo_tuner.evidence.certificate.search_width import SearchWidth, search_widths
from bo_tuner.evidence.words.certificate import of_widths
from bo_tuner.study.context_space import ContextSpace
from bo_tuner.study.distributions import Discrete, Uniform

TOOL = Discrete(values=(1.0, 2.0, 4.0), probabilities=(0.98, 0.01, 0.01))


def box(dimension):
    return ContextSpace({f"w{k}": Uniform(bounds=(2.0, 6.0)) for k in range(dimension)})


def widths(space, points):
    contexts = [space.to_dict(row) for row in space.to_contexts(np.array(points))]
    return {item.probability: item.width for item in search_widths(space, contexts)}


@pytest.mark.parametrize("dimension", [1, 2, 3])
def test_one_context_in_the_middle(dimension):
    """A cube meets it if its middle is within w/2 in each coordinate: w^d of all places."""
    found = widths(box(dimension), [[0.5] * dimension])
    assert found == {p: pytest.approx(p ** (1.0 / dimension), abs=0.01) for p in (0.9, 0.5)}


@pytest.mark.parametrize("count", [2, 10])
def test_a_regular_row(count):
    """Each of n contexts, in the middle of its n-th part, is met from the share n w of places."""
    found = widths(box(1), [[(k + 0.5) / count] for k in range(count)])
    assert found == {p: pytest.approx(p / count, abs=0.02 / count) for p in (0.9, 0.5)}


def test_one_in_a_corner_counts_a_quarter():
    """Of a square around it only a quarter is within the box: (w/2)^2 of all places."""
    found = widths(box(2), [[0.0, 0.0]])
    assert found[0.5] == pytest.approx(2.0 * math.sqrt(0.5), abs=0.02)


def test_a_discrete_value_has_to_be_evaluated():
    """However improbable it is in draws."""
    space = ContextSpace({"tool": TOOL, "load": Uniform(bounds=(0.0, 1.0))})
    middle = [[0.0, 0.5], [1.0 / 3.0, 0.5], [1.0, 0.5]]
    assert widths(space, middle) == {p: pytest.approx(p, abs=0.02) for p in (0.9, 0.5)}
    # With two of the three values, w of two thirds of the places.
    found = widths(space, middle[:2])
    assert found[0.5] == pytest.approx(0.75, abs=0.02)
    assert math.isinf(found[0.9])


def test_discrete_values_alone_have_no_width():
    assert search_widths(ContextSpace({"tool": TOOL}), [{"tool": 1.0}]) == ()


def test_in_words():
    both = [SearchWidth(0.9, 0.1432), SearchWidth(0.5, 0.068)]
    assert of_widths(both) == (
        "a violation of at least 0.14 of the box's edges in width would have been found with a "
        "probability of 90 %, one of 0.068 with a probability of 50 %"
    )
    assert "90 %" not in of_widths([SearchWidth(0.9, math.inf), both[1]])
    assert of_widths([SearchWidth(0.9, 1.2), SearchWidth(0.5, math.nan)]) == ""
