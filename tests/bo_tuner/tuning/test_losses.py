"""Evaluations that came to nothing are run again, without a backend or a plan."""

from dataclasses import replace

import pytest
from ten_lines import COMPLETE, FAILED

from bo_tuner.run_notes import Death, Notes, Unusable
from bo_tuner.trials import EvaluationState, Outcome
from bo_tuner.tuning.losses import MOST_DEATHS, Attempts

LOST = Outcome(EvaluationState.LOST, reason="axis is gone")
DISTURBED = replace(FAILED, notes=Notes(unusable=Unusable.DISTURBED))
DIED = Outcome(
    EvaluationState.LOST, reason="sim was ended by SIGABRT", notes=Notes(death=Death("sim"))
)
DIED_ANYWAY = DIED.noted(death=Death("sim", anyway=True))


def taken(attempts, *outcomes):
    """Return what one evaluation comes to, of which these are the attempts."""
    for count, outcome in enumerate(outcomes, 1):
        judged = attempts.judged(outcome)
        if not attempts.is_due_again(judged):
            return count, judged
    return None


@pytest.mark.parametrize("outcome", [COMPLETE, FAILED])
def test_what_says_something_of_the_parameters_is_not_run_again(outcome):
    assert taken(Attempts(3), outcome, COMPLETE) == (1, outcome)


@pytest.mark.parametrize("outcome", [LOST, DISTURBED])
def test_what_says_nothing_is_run_again_up_to_a_number(outcome):
    attempts = Attempts(3)
    assert taken(attempts, outcome, outcome, outcome, COMPLETE) == (3, outcome)
    # The next evaluation has as many attempts.
    assert taken(attempts, outcome, outcome, COMPLETE) == (3, COMPLETE)


def test_a_death_is_run_again_and_counts_nothing():
    attempts = Attempts(1)
    for _ in range(3):
        assert taken(attempts, DIED, COMPLETE) == (2, COMPLETE)


def test_two_deaths_are_a_failure_of_the_parameters():
    count, outcome = taken(Attempts(1), DIED, DIED, COMPLETE)
    assert (count, outcome.state, outcome.unusable) == (2, EvaluationState.FAILED, False)
    assert outcome.reason.startswith("sim was ended by SIGABRT; it died twice with these")
    assert "nodes.sim.death" in outcome.reason
    assert "abort_when" in outcome.reason


def test_a_node_that_dies_anyway_is_run_until_it_ends():
    attempts = Attempts(1)
    for _ in range(2):
        found = taken(attempts, DIED_ANYWAY, DIED_ANYWAY, DIED_ANYWAY, COMPLETE)
        assert found == (4, COMPLETE.noted(deaths=3))


def test_a_node_that_always_dies_anyway_is_lost():
    found = taken(Attempts(1), *[DIED_ANYWAY] * 2 * MOST_DEATHS)
    assert found == (MOST_DEATHS, DIED_ANYWAY)
