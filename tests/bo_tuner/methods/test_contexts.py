"""How many runs a trial begins with."""

import pytest

from bo_tuner.methods.contexts import DrawnContexts


@pytest.mark.parametrize(
    ("sections", "runs"),
    [
        ({}, 2),
        ({"noise": "none"}, 2),
        ({"contexts": {}}, 2),
        ({"contexts": {}, "noise": "none"}, 1),
    ],
)
def test_a_second_run_is_made_where_it_can_differ(make_study, sections, runs):
    study = make_study(budget={"trials": 8, "initial_trials": 4}, **sections)
    assert DrawnContexts(2).count(study) == runs


def test_what_the_study_says_goes_before(make_study):
    budget = {"trials": 8, "initial_trials": 4, "drawn_contexts": 3}
    assert DrawnContexts(2).count(make_study(budget=budget, contexts={}, noise="none")) == 3
