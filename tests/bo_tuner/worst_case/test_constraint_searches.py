"""Several worst-case limits of one parameter set, on a function whose extremes are known."""

import numpy as np
import pytest

from bo_tuner.study.constraint import Constraint
from bo_tuner.study.context_space import ContextSpace
from bo_tuner.study.distributions import Uniform
from bo_tuner.worst_case.constraint_searches import ConstraintSearch, WorstCaseSearches
from tuning_benchmark.paper.reinterpolation_search import OBSERVED, ReinterpolationSearch

SPACE = ContextSpace({"load": Uniform(bounds=(0.0, 4.0))})


def height(load):
    """Largest, 2, at 1, and smallest, -3, at 3."""
    return 2.0 - (load - 1.0) ** 2 if load < 2.0 else -3.0 + 4.0 * (load - 3.0) ** 2


def run(limits, evaluations):
    searches = WorstCaseSearches(
        [
            ConstraintSearch(
                constraint,
                ReinterpolationSearch(SPACE, constraint.sign * constraint.limit, evaluations),
            )
            for constraint in limits
        ],
        evaluations,
    )
    rng = np.random.default_rng(0)
    asked = []
    for load in (0.2, 1.7, 2.4, 3.9):
        searches.tell({"load": load}, {"height": height(load)})
    while not searches.done(rng):
        asked.append(searches.ask(rng)["load"])
        searches.tell({"load": asked[-1]}, {"height": height(asked[-1])})
    return searches.worst_cases(rng), asked


def limit(name, **limits):
    return Constraint(name=name, kind="worst_case", metric="height", **limits)


def test_each_finds_the_extreme_on_its_side():
    found, asked = run([limit("top", upper=2.5), limit("bottom", lower=-3.5)], 16)
    assert len(asked) == 16
    assert found["top"].context["load"] == pytest.approx(1.0, abs=0.2)
    assert found["top"].value == pytest.approx(2.0, abs=0.1)
    assert found["bottom"].context["load"] == pytest.approx(3.0, abs=0.2)
    assert found["bottom"].value == pytest.approx(-3.0, abs=0.2)
    assert found["bottom"].observed == min(height(x) for x in [*asked, 0.2, 1.7, 2.4, 3.9])


def test_a_violated_limit_leaves_the_evaluations_to_the_others():
    """Even the first evaluations are above 0, which ends the search for the top."""
    found, asked = run([limit("top", upper=0.0), limit("bottom", lower=-3.5)], 8)
    assert len(asked) == 8
    assert found["bottom"].context["load"] == pytest.approx(3.0, abs=0.2)
    alone, asked = run([limit("top", upper=0.0)], 8)
    assert asked == []
    assert alone["top"].observed == height(1.7)


def test_without_limits_there_is_nothing_to_search():
    assert run([], 8) == ({}, [])


def test_the_largest_number_of_evaluations_is_that_of_all_together():
    limits = [limit(f"top{k}", upper=5.0) for k in range(3)]
    assert len(run(limits, 7)[1]) == 7


def test_the_mirror_image_of_a_search():
    """A lower limit on a metric is an upper one on its negative."""
    upper, lower = limit("a", upper=5.0), limit("b", lower=-5.0)
    for constraint, sign in ((upper, 1.0), (lower, -1.0)):
        search = ReinterpolationSearch(SPACE, 5.0, 0, OBSERVED)
        item = ConstraintSearch(constraint, search)
        for load in (0.2, 1.1, 2.5):
            item.tell({"load": load}, {"height": sign * height(load)})
        worst = item.worst_case(np.random.default_rng(0))
        assert worst.value == worst.observed == sign * height(1.1)
        assert worst.context == {"load": 1.1}
