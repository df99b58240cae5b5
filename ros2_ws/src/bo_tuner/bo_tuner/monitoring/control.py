"""Requests to pause, continue, finish and end a run, and answers, from outside of the terminal."""

from collections.abc import Iterable
from pathlib import Path

from bo_tuner.interruption import Interruption
from bo_tuner.storage.run_folder import how_to_resume
from bo_tuner.tuning.gate import Gate
from bo_tuner.tuning.question import Given, Reply

COMES_OF = {
    Reply.ACCEPT: "the parameter set is tried",
    Reply.REFUSE: "the parameter set is not tried, nor anything close to it, but another one",
    Reply.END: "no more trials; the best so far is settled and validated",
}
"""What comes of an answer."""


class RunControl:
    """Passes requests on to the run, from any thread, and says in words what comes of them."""

    def __init__(self, gate: Gate, interruption: Interruption, folder: Path) -> None:
        self._gate = gate
        self._interruption = interruption
        self._folder = folder

    def going_on(self, ways: Iterable[str]) -> str:
        """Say how a run that is paused goes on: in `ways`, if there are any, or by a restart."""
        restart = f"end the run with Ctrl-C and {how_to_resume(self._folder)}"
        return ", or ".join([*(f"continue it {way}" for way in ways), restart])

    @property
    def pause_requested(self) -> bool:
        """Whether the run waits, or will after the present evaluation."""
        return self._gate.requests.requested

    def pause(self, wait: bool) -> str:
        """Ask the run to wait, or to go on."""
        self._gate.requests.request(wait)
        return "the run pauses after the present test run" if wait else "the run continues"

    def finish(self) -> str:
        """Ask for the end of the trials, so that the best so far becomes the result."""
        self._gate.finish()
        waits = " once it continues" if self.pause_requested else ""
        return (
            f"the run begins no further trial{waits}; the best so far is then settled and validated"
        )

    def answer(self, given: Given, number: int | None = None) -> tuple[bool, str]:
        """Answer the question whether the next parameter set may be tried."""
        if not self._gate.question.answer(given, number):
            return False, "this parameter set waits for no answer (any more)"
        return True, COMES_OF[given.reply]

    def abort(self, source: str) -> str:
        """Ask for the end of the run as SIGTERM does; `source` says who asks."""
        self._interruption.request(source)
        return f"the run ends; {how_to_resume(self._folder)}"
