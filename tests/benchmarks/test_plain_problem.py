"""Ranks of the plain problem."""

import pytest
from plain_problem import ranks, summary


def results(*best):
    return [{"best": value, "seconds": 1.0} for value in best]


def test_the_median_ranks_and_what_keeps_no_limit_comes_last():
    found = {
        "a": results(3.0, 1.0, 2.0),
        "b": results(0.0, None, None),
        "c": results(2.0, 2.0, 9.0),
        "d": results(1.0, 0.5, None),
    }
    # Medians 2, none, 2 and 1: equal ones share the ranks 2 and 3.
    assert ranks(found) == {"a": 2.5, "b": 4.0, "c": 2.5, "d": 1.0}


def test_a_group_has_the_means_of_its_functions_and_counts_who_is_first():
    functions = {
        "f1": {"ranks": {"a": 1.0, "b": 2.0}, "results": {"a": results(0.0), "b": results(1.0)}},
        "f2": {"ranks": {"a": 1.5, "b": 1.5}, "results": {"a": results(1.0), "b": results(1.0)}},
    }
    of_group = summary(functions)
    assert [of_group[name]["mean rank"] for name in "ab"] == pytest.approx([1.25, 1.75])
    assert [of_group[name]["first"] for name in "ab"] == [2, 1]
