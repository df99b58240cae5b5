"""Requests to pause and continue a run, in words."""

from bo_tuner.monitoring.control import RunControl
from bo_tuner.plans import ON_REQUEST, Phase
from bo_tuner.tuning.gate import Gate


def test_a_paused_run_can_always_go_on(tmp_path):
    """Also without any service or page: it is ended and resumed."""
    control = RunControl(Gate(), None, tmp_path)
    restart = f"end the run with Ctrl-C and resume it with: tune --resume {tmp_path}"
    assert control.going_on([]) == restart
    ways = ["on the live page", "by the service /a/tuner/pause"]
    assert control.going_on(ways) == (
        f"continue it on the live page, or continue it by the service /a/tuner/pause, or {restart}"
    )


def test_the_end_of_the_trials_is_asked_for_also_during_a_pause(tmp_path):
    """Only what waits for somebody goes on waiting: the guard may have taken over."""
    gate = Gate()
    control = RunControl(gate, None, tmp_path)
    assert control.finish() == (
        "the run begins no further trial; the best so far is then settled and validated"
    )
    assert gate.finishing(Phase.TUNING) == ON_REQUEST
    # The answer is settled as usual.
    assert gate.finishing(Phase.CHECKING) is None
    control.pause(True)
    assert control.finish().startswith("the run begins no further trial once it continues; the")
    assert control.pause_requested
