"""Nodes are left as they are to be after a run, however it ended."""

from contextlib import nullcontext
from types import SimpleNamespace

import pytest
from ten_lines import COMPLETE, FAILED, PLANNED, Machine

from bo_tuner.backends.layers.suspension import LONGEST, Suspension
from bo_tuner.backends.ros.errors import LostError
from bo_tuner.backends.ros.guard.link import LEASE
from bo_tuner.backends.ros.left_safe import LeftSafe
from bo_tuner.errors import BackendError
from bo_tuner.interruption import Interrupted
from bo_tuner.trials import EvaluationState, Outcome

LOST = Outcome(EvaluationState.LOST, reason="axis is gone")
NOT_PARKED = "axis is not parked: it is silent"


class Nodes:
    """Notes what is done with them; what it comes to is given by name."""

    def __init__(self, unfinished=(), **comes_to):
        self.done = []
        self.before_abort = ()
        self.has_ended = False
        self.unfinished = list(unfinished)
        self.parts = SimpleNamespace(
            safe_state=self, tuner=self, started=self, bringup=self, procedure=self
        )
        for name in ("stop", "park", "recover", "get_back", "warn"):
            setattr(self, name, self._noting(name, comes_to.get(name, ())))

    def _noting(self, name, comes_to):
        def act(*said, **how):
            self.done.append(said[0] if said else name)
            if isinstance(comes_to, BaseException):
                raise comes_to
            return list(comes_to)

        return act

    def take_unfinished(self):
        taken, self.unfinished = self.unfinished, []
        return taken


def left(nodes, run, *, taken_over=False, attached=False):
    """Return the outcome of a run by a layer around it, in which things are left unfinished."""
    unfinished = nodes.take_unfinished()

    def leaving(planned):
        nodes.unfinished += unfinished
        return run(planned)

    def at_abort(planned, outcome, latest):
        nodes.done.append((outcome.state, latest))

    guarded = SimpleNamespace(taken_over=taken_over)
    return LeftSafe(nodes.parts, guarded, at_abort, attached=attached)(leaving)(PLANNED)


def test_a_complete_run_has_left_them_already():
    nodes = Nodes()
    assert left(nodes, Machine().run) == COMPLETE
    assert nodes.done == []


def test_one_that_could_not_be_parked_after_a_complete_run_is_parked_at_once():
    nodes = Nodes(unfinished=[NOT_PARKED], park=[NOT_PARKED])
    outcome = left(nodes, Machine().run)
    assert outcome == COMPLETE.noted(park_problem=NOT_PARKED)
    assert nodes.done == ["park", NOT_PARKED], "it is tried again, and said once"


def test_after_a_failure_the_machine_is_brought_home():
    nodes = Nodes(unfinished=[NOT_PARKED], recover=[NOT_PARKED, "not recovered: it is stuck"])
    outcome = left(nodes, Machine(FAILED).run)
    assert nodes.done == ["recover"]
    assert outcome.state is EvaluationState.FAILED
    assert outcome.reason == f"stalled; {NOT_PARKED}; not recovered: it is stuck"


@pytest.mark.parametrize(("outcome", "has_ended"), [(LOST, False), (FAILED, True)])
def test_a_node_that_is_gone_is_got_back_once_the_others_are_safe(outcome, has_ended):
    nodes = Nodes()
    nodes.has_ended = has_ended
    assert left(nodes, Machine(outcome).run) == outcome
    assert nodes.done == ["stop", "get_back", "recover"]


def test_a_node_that_does_not_come_back_is_said():
    nodes = Nodes(get_back=LostError("axis does not start"))
    outcome = left(nodes, Machine(LOST).run)
    assert outcome.reason == "axis is gone; not recovered: axis does not start"
    assert nodes.done == ["stop", "get_back"]


@pytest.mark.parametrize("when", ["in the run", "on the way home"])
def test_what_ends_the_whole_run_stops_the_machine_first(when):
    def interrupted(planned):
        raise Interrupted(2)

    if when == "in the run":
        nodes = Nodes(unfinished=["the brake is on"], stop=[NOT_PARKED])
        nodes.before_abort = ("the last message",)
        with pytest.raises(Interrupted):
            left(nodes, interrupted)
        told = (EvaluationState.LOST, nodes.before_abort)
        assert nodes.done == ["stop", NOT_PARKED, "the brake is on", told]
    else:
        nodes = Nodes(recover=Interrupted(2))
        assert left(nodes, Machine(FAILED).run) == FAILED, "what is known is kept"
        assert nodes.done == ["recover", "stop"]


def test_an_abort_is_told_of_before_the_machine_drives_home():
    nodes = Nodes()
    nodes.before_abort = ("the last message",)
    left(nodes, Machine(FAILED).run)
    assert nodes.done == [(EvaluationState.FAILED, nodes.before_abort), "recover"]


@pytest.mark.parametrize(
    ("slept", "taken_over", "is_dead"),
    [
        (LEASE - 0.5, True, False),
        (LEASE + 0.5, True, True),
        (LEASE + 0.5, False, False),
        (LONGEST + 0.5, False, True),
    ],
)
def test_a_process_that_ros_takes_for_dead_does_not_go_on(slept, taken_over, is_dead):
    """A short gap is that of a busy computer, unless the guard has found it too long."""
    machine, nodes = Machine(LOST), Nodes(stop=[NOT_PARKED])
    machine.takes = slept
    nodes.parts.suspension = Suspension(machine.clock)
    refused = pytest.raises(BackendError, match=r"^this process was stopped for .* s, and ROS took")
    with refused if is_dead else nullcontext():
        left(nodes, machine.run, taken_over=taken_over, attached=True)
    assert nodes.done == (["stop"] if is_dead else ["stop", "get_back", "recover"])
