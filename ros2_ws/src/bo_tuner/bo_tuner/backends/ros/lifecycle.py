"""A lifecycle node on the way from one state to another."""

import time
from collections.abc import Callable
from dataclasses import replace

from bo_tuner.backends.ros.errors import RefusedError
from bo_tuner.backends.ros.steps import LifecycleChange
from bo_tuner.backends.ros.tuner_node import POLL_PERIOD, TunerNode
from bo_tuner.metrics.recording import FailedRunError
from bo_tuner.study.steps import Lifecycle

DISCOVERED = 1.0
"""Time [s] in which a node that has just been discovered shows that it has a lifecycle."""
MANAGED = 20.0
"""Time [s] that a launch file has to configure and activate its nodes itself."""
ACTIVE, INACTIVE, UNCONFIGURED = "active", "inactive", "unconfigured"
NEXT = {
    (UNCONFIGURED, INACTIVE): "configure",
    (UNCONFIGURED, ACTIVE): "configure",
    (INACTIVE, ACTIVE): "activate",
    (INACTIVE, UNCONFIGURED): "cleanup",
    (ACTIVE, INACTIVE): "deactivate",
    (ACTIVE, UNCONFIGURED): "deactivate",
}
"""The transition from one state on the way to another."""


class LifecycleNode:
    """A node with a lifecycle; its methods raise `LostError` if it does not answer."""

    goes_on = False

    def __init__(self, tuner: TunerNode, node: str) -> None:
        self._tuner = tuner
        self._change = LifecycleChange.prepare(tuner, Lifecycle(node=node, transition="configure"))

    @classmethod
    def find(cls, tuner: TunerNode, node: str) -> "LifecycleNode | None":
        """Return a node that has just been discovered; None if it has no lifecycle."""
        service = tuner.node.resolve_service_name(f"{node}/change_state")
        has_one = tuner.wait_until(lambda: tuner.node.count_services(service) > 0, DISCOVERED)
        return cls(tuner, node) if has_one else None

    @property
    def state(self) -> str:
        """Its state, such as ``active``."""
        return self._change.current_state

    def wait_for(self, state: str) -> None:
        """Wait until somebody else has brought it to a state, for a while."""
        self._tuner.wait_until(lambda: self.state == state, MANAGED)

    def configure_anew(self, target: str = "", between: Callable[[], None] = lambda: None) -> None:
        """Take its configuration back, and bring it to a state again."""
        target = target or self.state
        self.bring_to(UNCONFIGURED)
        between()
        self.bring_to(target)

    def bring_to(self, target: str) -> None:
        """Change its state step by step; somebody else may do so at the same time."""
        deadline = time.monotonic() + self._change.spec.timeout
        while (state := self.state) != target:
            transition = NEXT.get((state, target))
            if transition is None:
                # On its way, such as `configuring`.
                if time.monotonic() > deadline:
                    raise RefusedError(f"{self._change.spec.node} is {state}, and stays so")
                self._tuner.spin_for(POLL_PERIOD)
                continue
            spec = replace(self._change.spec, transition=transition)
            try:
                replace(self._change, spec=spec).perform()
            except FailedRunError as error:
                if self.state == state:
                    raise RefusedError(str(error)) from error
