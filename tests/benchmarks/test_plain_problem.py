"""Ranks of the plain problem, and a record that is made in parts."""

import json

import pytest
from plain_problem import known, summary

NAMES = ("boundary", "Optuna GP", "CMA-ES")


def run(function, instance, optimizer, found, evaluations=50):
    return {
        "kind": "plain",
        "dimension": 2,
        "evaluations": evaluations,
        "function": function,
        "instance": instance,
        "optimizer": optimizer,
        "found": found,
        "seconds": 1.0,
    }


def problem(function, instance, *found):
    return [run(function, instance, *each) for each in zip(NAMES, found, strict=True)]


def test_equal_ones_share_a_rank_and_what_keeps_no_limit_comes_last():
    group = summary(problem(1, 1, 2.0, 2.0, None))["plain, 2D, 50"]
    assert group["functions"] == {"f1": {"boundary": 1.5, "Optuna GP": 1.5, "CMA-ES": 3.0}}
    assert [group["optimizers"][name]["first"] for name in NAMES] == [1, 1, 0]


def test_ranks_are_over_the_problems_that_all_have_done():
    runs = [
        *problem(1, 1, 1.0, 2.0, 3.0),
        *problem(1, 2, 2.0, 1.0, 3.0),
        *problem(2, 1, 3.0, 1.0, 2.0),
        *problem(2, 2, 1.0, 2.0, 3.0)[:2],
    ]
    group = summary(runs)["plain, 2D, 50"]
    assert (group["problems"], group["instances"]) == (3, 2)
    means = [group["optimizers"][name]["mean rank"] for name in NAMES]
    assert means == pytest.approx([2.0, 4.0 / 3.0, 8.0 / 3.0])
    assert group["functions"]["f1"]["boundary"] == 1.5


def test_of_two_records_the_later_one_counts(tmp_path):
    first, second = tmp_path / "first.json", tmp_path / "second.json"
    first.write_text(json.dumps({"runs": problem(1, 1, 1.0, 2.0, 3.0)}))
    second.write_text(json.dumps({"runs": [run(1, 1, "boundary", 5.0)]}))
    found = known([first, tmp_path / "none.json", second])
    assert [each["found"] for each in found.values()] == [5.0, 2.0, 3.0]
