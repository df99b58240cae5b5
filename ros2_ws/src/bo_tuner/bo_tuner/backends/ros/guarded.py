"""What becomes of a run where the guard of its nodes acts, or is silent."""

import contextlib
from collections.abc import Callable

from bo_tuner.backends.layers.layer import Run
from bo_tuner.backends.ros.guard.link import GuardActedError, GuardLink, GuardSilentError
from bo_tuner.backends.ros.opened import Opened
from bo_tuner.backends.ros.tuner_node import SPIN_PERIOD
from bo_tuner.errors import BackendError
from bo_tuner.text import brief
from bo_tuner.trials import Evaluation, EvaluationState, Outcome

AGAIN = 0.5
"""Time [s] between two attempts to leave the machine safe while its guard is silent."""


class Guarded:
    """A layer around a run that heeds the guard, if there is one.

    Attributes
    ----------
    taken_over : bool
        Whether the guard has taken the machine over in the last run.
    """

    def __init__(
        self,
        opened: Opened,
        guard: GuardLink | None,
        halt: Callable[[str], None] | None,
    ) -> None:
        self._tuner = opened.tuner
        self._safe_state = opened.safe_state
        self._procedure = opened.procedure
        self._guard = guard
        self._look = opened.look
        self._halt = halt
        self.taken_over = False

    def __call__(self, run: Run) -> Run:
        """Return a run that is lost if the guard acts in it.

        What the guard sets and publishes would else be taken for somebody else's doing.
        """

        def guarded(planned: Evaluation) -> Outcome:
            self.taken_over = False
            outcome = run(planned)
            try:
                # The guard publishes ten states a second, but has set the nodes already.
                self._wait(0.0 if outcome.state is EvaluationState.COMPLETE else SPIN_PERIOD)
            except GuardActedError as acted:
                return self.overruled(acted)
            return outcome

        return guarded

    def heed(self) -> None:
        """Raise what the guard has done since the last run, such as while a node was waited for."""
        self._wait(0.0)
        if self._guard is not None and self._guard.unheeded is not None:
            raise self._guard.unheeded

    def overruled(self, acted: GuardActedError) -> Outcome:
        """Return the outcome of an evaluation in which the guard has acted."""
        if self._guard is not None:
            self._guard.unheeded = None
        aborted = "" if self._procedure is None else self._procedure.reason_of_abort
        if acted.on_condition and aborted and not acted.ends:
            # It was quicker than this process, which would have done the same.
            return Outcome(EvaluationState.FAILED, {}, brief(f"{aborted}; {acted}"))
        if acted.takes_over:
            self.taken_over = True
            if self._halt is None or acted.ends:
                raise BackendError(str(acted)) from acted
            self._halt(str(acted))
        return Outcome(EvaluationState.LOST, {}, brief(str(acted)))

    def _wait(self, period: float) -> None:
        """See for a period [s] what the guard does; if it is silent, wait with the machine safe.

        It is left safe first, and again as long as ROS does not carry that.
        """
        guard, tuner = self._guard, self._tuner
        if guard is None:
            return

        def look() -> None:
            self._look()
            guard.look(at_rest=False)

        # A node that has ended keeps nobody from seeing to the machine.
        with tuner.watched_by(look):
            with contextlib.suppress(GuardSilentError):
                guard.look(at_rest=False)
                if not guard.is_silent:
                    tuner.spin_for(period)
            if not guard.is_silent:
                return
            problems = self._safe_state.stop()
            while not tuner.wait_until(lambda: not guard.is_silent, AGAIN):
                problems = problems and self._safe_state.stop()
