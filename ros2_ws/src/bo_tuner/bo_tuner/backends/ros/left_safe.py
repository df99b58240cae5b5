"""Leaves the nodes as they are to be after a run, however it ended."""

from collections.abc import Callable, Sequence
from dataclasses import replace

from bo_tuner.backends.layers.layer import Run
from bo_tuner.backends.ros.errors import LostError
from bo_tuner.backends.ros.guard.link import LEASE
from bo_tuner.backends.ros.guarded import Guarded
from bo_tuner.backends.ros.opened import Opened
from bo_tuner.errors import BackendError, StudyError
from bo_tuner.interruption import Interrupted
from bo_tuner.metrics.latest_messages import LatestMessage
from bo_tuner.text import brief
from bo_tuner.trials import Evaluation, EvaluationState, Outcome

AtAbort = Callable[[Evaluation, Outcome, Sequence[LatestMessage]], object]
"""Takes an evaluation whose run was aborted, its outcome, and the messages until then."""


class LeftSafe:
    """A layer that leaves the machine safe after each run, and gets back nodes that were lost.

    `at_abort` is told of a run that was aborted.
    """

    def __init__(
        self, opened: Opened, guarded: Guarded, at_abort: AtAbort, *, attached: bool
    ) -> None:
        self._opened = opened
        self._guarded = guarded
        self._at_abort = at_abort
        self._attached = attached

    def __call__(self, run: Run) -> Run:
        """Return a run after which the nodes are left as they are to be."""

        def left_safe(planned: Evaluation) -> Outcome:
            safe_state = self._opened.safe_state
            safe_state.take_unfinished()
            try:
                outcome = run(planned)
            except BaseException as error:
                # Such as a signal. Records are closed before the backend is, and may take their
                # time.
                for problem in [*safe_state.stop(), *safe_state.take_unfinished()]:
                    self._opened.tuner.warn(problem)
                self._tell_of_abort(planned, Outcome(EvaluationState.LOST, {}, brief(str(error))))
                raise
            self._tell_of_abort(planned, outcome)
            try:
                problems = self._leave(outcome.state)
            except Interrupted:
                # The run ends, but not without what is known of these parameters.
                problems = safe_state.stop()
            return self._with_problems(outcome, [*safe_state.take_unfinished(), *problems])

        return left_safe

    def _with_problems(self, outcome: Outcome, problems: Sequence[str]) -> Outcome:
        """Return an outcome with what went wrong after the run."""
        if not problems:
            return outcome
        # What was tried more than once is reported once.
        text = brief("; ".join(dict.fromkeys(problems)))
        if outcome.state is EvaluationState.COMPLETE:
            # The outcome of a complete run does not say what went wrong after it.
            self._opened.tuner.warn(text)
            return outcome.noted(park_problem=text)
        said = [problem for problem in problems if problem not in outcome.reason]
        return replace(outcome, reason=brief("; ".join(dict.fromkeys([outcome.reason, *said]))))

    def _tell_of_abort(self, planned: Evaluation, outcome: Outcome) -> None:
        procedure = self._opened.procedure
        if procedure is not None and procedure.before_abort:
            self._at_abort(planned, outcome, procedure.before_abort)

    def _leave(self, state: EvaluationState) -> list[str]:
        """Leave the nodes as they are to be; returns what went wrong."""
        safe_state = self._opened.safe_state
        if state is EvaluationState.COMPLETE:
            # What was not parked right after a run is not watched until the next one.
            return safe_state.take_unfinished() and safe_state.park(at_once=True)
        if state is EvaluationState.LOST or self._opened.started.has_ended:
            # Of the node that was lost nothing else is to be expected than that it is not parked.
            if (problems := safe_state.stop()) and self._attached:
                self._expect_to_be_known(problems)
            try:
                self._opened.bringup.get_back()
            except (LostError, BackendError, StudyError) as error:
                # The next evaluation will be lost in turn; three lost trials end the run.
                return [f"not recovered: {error}"]
        return safe_state.recover()

    def _expect_to_be_known(self, problems: list[str]) -> None:
        """Refuse to go on if this process was stopped, and nodes do not answer it since then.

        ROS takes a process that is silent for long for dead. One that lives again is discovered
        anew, but its services may never be answered again (Fast DDS 2.14).
        """
        suspension = self._opened.suspension
        suspension.look()
        # A shorter gap is that of a busy computer, unless the guard has found it too long.
        seconds = suspension.longest if self._guarded.taken_over else suspension.seconds
        if seconds > LEASE:
            raise BackendError(
                f"this process was stopped for {seconds:.0f} s, and ROS took it for dead: "
                f"{'; '.join(problems)}; look at the machine, then resume the run"
            )
