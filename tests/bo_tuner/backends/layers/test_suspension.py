"""A time that this process slept through."""

import pytest
from ten_lines import COMPLETE, PLANNED, Machine

from bo_tuner.backends.layers.suspension import LONGEST, Suspension, not_suspended
from bo_tuner.interruption import Interrupted
from bo_tuner.trials import EvaluationState, Outcome

LOST = Outcome(EvaluationState.LOST, reason="no evaluation result")
SLEPT = 20.0


def test_only_a_gap_between_two_looks_is_a_suspension():
    machine = Machine()
    watch = Suspension(machine.clock)
    for _ in range(1000):
        machine.now += LONGEST / 2
        watch.look()
    assert watch.seconds == 0.0
    machine.now += SLEPT
    watch.skip()
    watch.look()
    assert watch.seconds == 0.0
    machine.now += SLEPT
    watch.look()
    assert watch.seconds == SLEPT
    watch.begin()
    assert watch.seconds == 0.0


def repeated(machine, look=lambda: None, settled=lambda: False):
    """Return a run that is repeated; the machine sleeps in those that are lost."""
    watch = Suspension(machine.clock)

    def run(planned):
        outcome = machine.run(planned)
        machine.now += SLEPT if outcome is LOST else 0.0
        return outcome

    # A search between two runs is no suspension.
    machine.now += SLEPT
    return not_suspended(watch, look, settled)(run)


@pytest.mark.parametrize("suspended", [0, 1, 2, 3])
def test_what_was_slept_through_is_repeated(suspended):
    """Whatever came of it, and not for ever."""
    machine = Machine(*[LOST] * suspended)
    outcome = repeated(machine)(PLANNED)
    if suspended < 3:
        assert outcome == COMPLETE
        assert machine.ran == [PLANNED] * (suspended + 1)
    else:
        assert outcome.state is EvaluationState.LOST
        assert outcome.reason == "the tuner was suspended for 21 s"
        assert machine.ran == [PLANNED] * 3


def test_what_is_settled_is_not_repeated():
    machine = Machine(LOST)
    assert repeated(machine, settled=lambda: True)(PLANNED) == LOST
    assert machine.ran == [PLANNED]


def test_a_request_to_end_that_came_meanwhile_is_heeded_ahead_of_another_run():
    machine = Machine(LOST)

    def look():
        if machine.ran:
            raise Interrupted(2)

    with pytest.raises(Interrupted):
        repeated(machine, look)(PLANNED)
    assert machine.ran == [PLANNED]
