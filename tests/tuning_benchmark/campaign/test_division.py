"""Evaluations of a row, divided between the trials and the search for the answer."""

from dataclasses import replace

import pytest

from bo_tuner.methods.boundary.settling import Repetitions
from bo_tuner.methods.registry import METHODS
from bo_tuner.methods.repetitions import most_check_evaluations
from tuning_benchmark.campaign.division import divided, further_trials

BOUNDARY = METHODS["boundary"]


@pytest.mark.parametrize("whole", [30, 60, 80, 160, 301])
def test_trials_and_repetitions_fill_a_budget(make_study, whole):
    study = make_study()
    method, trials = divided(BOUNDARY, study, whole, reserved=40)
    assert method is BOUNDARY
    assert whole - 1 <= trials + method.repetitions.most(study, trials) <= whole


def test_without_repetitions_all_evaluations_are_of_trials(make_study):
    method = replace(BOUNDARY, repetitions=Repetitions(share=0.0))
    assert divided(method, make_study(), 100, reserved=40) == (method, 100)


@pytest.mark.parametrize(("reserved", "checks"), [(0, 0), (19, 0), (45, 2), (1000, 6)])
def test_as_many_candidates_are_checked_as_the_reserved_evaluations_allow(
    make_study, reserved, checks
):
    study = make_study()
    assert most_check_evaluations(study) == 20
    method, trials = divided(METHODS["IV"], study, 1100, reserved)
    assert method.check.most == checks
    assert trials == (1100 - reserved if checks else 1100)


def test_what_the_answer_left_is_of_trials_if_it_is_enough_for_one(make_study):
    study = make_study()
    # One run in a drawn context and two in the worst; a sixth as many are of repetitions.
    assert [further_trials(BOUNDARY, study, left) for left in (3, 4, 14)] == [0, 3, 12]
    assert further_trials(METHODS["IV"], study, 100) == 0
