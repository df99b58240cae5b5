"""Requests to pause and continue a run, in words."""

from bo_tuner.interruption import Pause
from bo_tuner.monitoring.control import RunControl


def test_a_paused_run_can_always_go_on(tmp_path):
    """Also without any service or page: it is ended and resumed."""
    control = RunControl(Pause(), None, tmp_path)
    restart = f"end the run with Ctrl-C and resume it with: tune --resume {tmp_path}"
    assert control.going_on([]) == restart
    ways = ["on the live page", "by the service /a/tuner/pause"]
    assert control.going_on(ways) == (
        f"continue it on the live page, or continue it by the service /a/tuner/pause, or {restart}"
    )
