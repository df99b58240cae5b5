"""What becomes of a run where the guard of its nodes acts."""

import contextlib
from types import SimpleNamespace

import pytest
from ten_lines import COMPLETE, PLANNED, Machine

from bo_tuner.backends.ros.guard.link import GuardActedError
from bo_tuner.backends.ros.guarded import Guarded
from bo_tuner.errors import BackendError
from bo_tuner.trials import EvaluationState

ABORTED = "aborted at 0.3 s: angle > 3"


def acted(*, takes_over=False, on_condition=False, ends=False):
    return GuardActedError(
        "the guard has acted", takes_over=takes_over, on_condition=on_condition, ends=ends
    )


class Guard:
    """Raises each act once, when it is looked at."""

    is_silent = False
    unheeded = None

    def __init__(self, *acts):
        self._acts = list(acts)

    def look(self, *, at_rest):
        if self._acts:
            self.unheeded = self._acts.pop(0)
            raise self.unheeded


def guarded(guard, aborted="", halt=None):
    tuner = SimpleNamespace(
        watched_by=lambda look: contextlib.nullcontext(), spin_for=lambda period: None
    )
    procedure = SimpleNamespace(reason_of_abort=aborted)
    opened = SimpleNamespace(tuner=tuner, safe_state=None, procedure=procedure, look=lambda: None)
    return Guarded(opened, guard, halt)


def test_a_guard_that_does_nothing_changes_nothing():
    assert guarded(Guard())(Machine().run)(PLANNED) == COMPLETE
    assert guarded(None)(Machine().run)(PLANNED) == COMPLETE


def test_a_run_in_which_it_acted_is_lost():
    """Also where it acted on a condition that this process has not seen to hold."""
    for act in (acted(), acted(on_condition=True)):
        outcome = guarded(Guard(act))(Machine().run)(PLANNED)
        assert (outcome.state, outcome.reason) == (EvaluationState.LOST, "the guard has acted")


def test_where_it_was_only_quicker_the_parameters_have_failed():
    outcome = guarded(Guard(acted(on_condition=True)), ABORTED)(Machine().run)(PLANNED)
    assert outcome.state is EvaluationState.FAILED
    assert outcome.reason == f"{ABORTED}; the guard has acted"


def test_where_it_takes_over_somebody_is_to_look_at_the_machine():
    halted = []
    layer = guarded(Guard(acted(takes_over=True)), halt=halted.append)
    run = layer(Machine().run)
    assert run(PLANNED).state is EvaluationState.LOST
    assert halted == ["the guard has acted"]
    assert layer.taken_over
    assert run(PLANNED) == COMPLETE
    assert not layer.taken_over


@pytest.mark.parametrize("ends", [False, True])
def test_a_run_that_nobody_can_halt_ends(ends):
    halt = (lambda text: None) if ends else None
    layer = guarded(Guard(acted(takes_over=True, ends=ends)), halt=halt)
    with pytest.raises(BackendError, match="the guard has acted"):
        layer(Machine().run)(PLANNED)


def test_what_it_did_while_a_node_was_waited_for_is_heeded_ahead_of_the_next_run():
    guard = Guard()
    layer = guarded(guard)
    layer.heed()
    guard.unheeded = acted()
    with pytest.raises(GuardActedError) as raised:
        layer.heed()
    layer.overruled(raised.value)
    layer.heed()
