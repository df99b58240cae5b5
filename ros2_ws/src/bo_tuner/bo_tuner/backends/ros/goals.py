"""Goals of actions: sent, watched, and cancelled when a run ends before them."""

from collections.abc import Mapping
from typing import Any

from action_msgs.msg import GoalStatus
from action_msgs.srv import CancelGoal
from rclpy.action import ActionClient, get_action_names_and_types
from rclpy.task import Future

from bo_tuner.backends.ros.answers import said
from bo_tuner.backends.ros.errors import LostError, SilentError
from bo_tuner.backends.ros.messages import interface_class, make_message
from bo_tuner.backends.ros.tuner_node import CALL_TIMEOUT, TunerNode
from bo_tuner.codec import checks
from bo_tuner.codec.findings import under
from bo_tuner.errors import StudyError
from bo_tuner.metrics.recording import FailedRunError
from bo_tuner.study.steps import SendGoal
from bo_tuner.text import brief

ENDS = {
    GoalStatus.STATUS_ABORTED: "aborted the goal",
    GoalStatus.STATUS_CANCELED: "cancelled the goal, which the tuner did not ask for",
}
UNKNOWN_GOAL = CancelGoal.Response.ERROR_UNKNOWN_GOAL_ID


class Goal:
    """A goal that is sent in each run."""

    def __init__(self, tuner: TunerNode, spec: SendGoal, timeout: float) -> None:
        self._tuner = tuner
        self._spec = spec
        self.name = tuner.node.resolve_service_name(spec.action)
        cls = self._find(timeout)
        self._kind = cls.Goal
        self.fill(spec)
        self._client = ActionClient(tuner.node, cls, self.name)
        if not tuner.wait_until(self._client.server_is_ready, timeout):
            raise StudyError(f"{self.name} has no server that is complete", ("action",))
        self._asked: Future | None = None
        self._handle: Any = None
        self._result: Future | None = None
        self._is_cancelled = False

    def fill(self, spec: SendGoal) -> None:
        """Send from now on the goal of a step that differs in the values of contexts."""
        with under("goal"):
            self._message = make_message(self._kind, spec.goal)

    @property
    def is_active(self) -> bool:
        """Whether the goal was accepted and is not known to have ended."""
        return self._result is not None and not self._result.done()

    @property
    def is_open(self) -> bool:
        """Whether it is active, or might yet be: the server has not answered."""
        return self._asked is not None or self.is_active

    def send(self) -> None:
        """Send the goal, and wait until it is accepted."""
        if self.is_active:
            raise LostError(f"{self.name} has not ended its goal")
        self._handle = self._result = None
        self._is_cancelled = False
        # A goal for a server that was started anew and is not discovered yet would be lost.
        if not self._tuner.wait_until(self._client.server_is_ready, CALL_TIMEOUT):
            raise self._silence
        asked = self._asked = self._client.send_goal_async(self._message)
        asked.add_done_callback(self._take)
        if not self._tuner.wait_until(lambda: self._asked is None, CALL_TIMEOUT):
            raise self._silence
        if self._result is None:
            raise FailedRunError(f"{self.name} refused the goal")

    @property
    def _silence(self) -> SilentError:
        return SilentError(f"the server of {self.name} does not answer within {CALL_TIMEOUT:g} s")

    def _take(self, asked: Future) -> None:
        """Take the server's answer to a goal, and cancel one that nobody waits for any more."""
        handle, is_late = asked.result(), asked is not self._asked
        if not is_late:
            self._asked = None
        if handle is None or not handle.accepted:
            return
        if is_late:
            handle.cancel_goal_async()
        else:
            self._handle, self._result = handle, handle.get_result_async()
            if self._is_cancelled:
                self.request_cancel()

    def check(self) -> None:
        """Check how the goal is going."""
        if self._result is None:
            return
        if not self._result.done():
            if not self._client.server_is_ready():
                raise LostError(f"the server of {self.name} is lost")
            return
        answer = self._result.result()
        if answer.status in ENDS:
            raise FailedRunError(f"{self.name} {ENDS[answer.status]}{_reason(answer.result)}")

    def wait(self) -> None:
        """Wait for the result; raises what `check` raises."""

        def ended() -> bool:
            self.check()
            return not self.is_active

        if not self._tuner.wait_until(ended, self._spec.timeout):
            raise FailedRunError(f"{self.name} has no result within {self._spec.timeout:g} s")

    def request_cancel(self) -> None:
        """Ask for the end of the goal, if it has none yet, and do not wait for it."""
        # One that is accepted only later, such as after an interruption, would be executed.
        self._is_cancelled = True
        if self.is_active:
            self._handle.cancel_goal_async().add_done_callback(self._take_cancelled)

    def _take_cancelled(self, asked: Future) -> None:
        """Take the answer to a request to cancel: a server that was started anew has no goal."""
        answer = asked.result()
        if answer is not None and answer.return_code == UNKNOWN_GOAL:
            self._result = None

    def cancel(self) -> str:
        """Cancel the goal if it is open, and wait for its end; returns what went wrong, in a line.

        With the result the server has come to rest.
        """
        self.request_cancel()
        if self._tuner.wait_until(lambda: not self.is_open, CALL_TIMEOUT):
            return ""
        return f"{self.unended} within {CALL_TIMEOUT:g} s of the request to cancel it"

    @property
    def unended(self) -> str:
        """Return a line on a goal that is open."""
        if self._asked is not None:
            return f"{self.name} may yet accept its goal: it does not answer"
        return f"{self.name} does not end its goal"

    def close(self) -> None:
        """Let go of the server."""
        self._client.destroy()

    def _find(self, timeout: float) -> Any:
        node = self._tuner.node

        def known() -> Mapping[str, list[str]]:
            return dict(get_action_names_and_types(node))

        if not self._tuner.wait_until(lambda: self.name in known(), timeout):
            raise StudyError(
                f"there is no action {self.name}; {checks.suggestion(self.name, sorted(known()))}",
                ("action",),
            )
        with under("action"):
            return interface_class(known()[self.name][0])


def _reason(result: Any) -> str:
    """Return what an action says of its end, if it has one of the usual fields."""
    reason = said(result) or brief(str(getattr(result, "error_code", 0)))
    return "" if reason == "0" else f": {reason}"
