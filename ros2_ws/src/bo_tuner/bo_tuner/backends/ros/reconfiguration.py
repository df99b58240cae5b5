"""How values that a node reads only while it is configured come into force while it runs."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

from bo_tuner.backends.ros.answers import refusal
from bo_tuner.backends.ros.errors import RefusedError
from bo_tuner.backends.ros.lifecycle import ACTIVE, MANAGED, UNCONFIGURED, LifecycleNode
from bo_tuner.backends.ros.steps import LifecycleChange, PreparedStep, ServiceCall, service_at
from bo_tuner.backends.ros.tuner_node import TunerNode
from bo_tuner.codec.findings import under
from bo_tuner.errors import StudyError
from bo_tuner.metrics.recording import FailedRunError
from bo_tuner.study.nodes import CONTROLLER_MANAGER, NodeSpec
from bo_tuner.study.steps import Step

CHANGE = 10.0
"""Time [s] that a controller_manager has for an answer: it switches in its control loop."""


class Reconfiguration(Protocol):
    """A running node that can be configured anew; methods raise `LostError` if it is silent."""

    @property
    def goes_on(self) -> bool:
        """Whether it goes on publishing meanwhile."""

    @property
    def state(self) -> str:
        """Its state, such as ``active``."""

    def wait_for(self, state: str) -> None:
        """Wait until somebody else has brought it to a state, for a while."""

    def bring_to(self, target: str) -> None:
        """Bring it to a state; raises `RefusedError` if it refuses."""

    def configure_anew(self, target: str = "", between: Callable[[], None] = lambda: None) -> None:
        """Configure it, and bring it to a state, by default that in which it is.

        `between` is called while it may be given values. Raises `RefusedError` if it refuses.
        """


def reconfiguration_of(tuner: TunerNode, spec: NodeSpec) -> Reconfiguration | None:
    """Return how a node that was just discovered is configured; None if it has no lifecycle."""
    with under("reconfigure"):
        if spec.reconfigure == CONTROLLER_MANAGER:
            return ControlledNode.prepare(tuner, spec.node)
        if isinstance(spec.reconfigure, tuple):
            return CalledSteps.prepare(tuner, spec.reconfigure)
    return LifecycleNode.find(tuner, spec.node)


@dataclass(frozen=True)
class CalledSteps:
    """A node that takes its values when steps of the study are performed."""

    steps: Sequence[PreparedStep]
    state: str = ACTIVE
    goes_on: bool = True

    @classmethod
    def prepare(cls, tuner: TunerNode, steps: Sequence[Step]) -> "CalledSteps":
        """Find the services; raises `StudyError` if there is none."""
        prepared: list[PreparedStep] = []
        for index, step in enumerate(steps):
            with under(index):
                if step.call is not None:
                    path = ("reconfigure", index, "call")
                    prepared.append(ServiceCall.prepare(tuner, step.call, path))
                elif step.lifecycle is not None:
                    prepared.append(LifecycleChange.prepare(tuner, step.lifecycle))
        return cls(prepared)

    def wait_for(self, state: str) -> None:
        """Return at once: nobody else configures it."""

    def bring_to(self, target: str) -> None:
        """Do nothing: it has one state."""

    def configure_anew(self, target: str = "", between: Callable[[], None] = lambda: None) -> None:
        """Perform the steps once values are set."""
        between()
        try:
            for step in self.steps:
                step.perform()
        except FailedRunError as error:
            raise RefusedError(str(error)) from error


class ControlledNode:
    """A controller of ros2_control, by the services of its manager."""

    goes_on = False

    def __init__(
        self, tuner: TunerNode, node: str, services: Mapping[str, tuple[Any, Any]]
    ) -> None:
        self._tuner = tuner
        self._name = node.rpartition("/")[2]
        self._services = services
        self._chain = self._active_chain(self._controllers())

    @classmethod
    def prepare(cls, tuner: TunerNode, node: str) -> "ControlledNode":
        """Find its manager, in its namespace; raises `StudyError` if there is none."""
        manager = "".join((*node.rpartition("/")[:2], CONTROLLER_MANAGER))
        names = ("list_controllers", "configure_controller", "switch_controller")
        return cls(tuner, node, {name: service_at(tuner, f"{manager}/{name}") for name in names})

    @property
    def state(self) -> str:
        """Its state, such as ``active``."""
        return self._state(self._controllers())

    def wait_for(self, state: str) -> None:
        """Wait until a spawner has brought it to a state, for a while."""
        self._tuner.wait_until(lambda: self.state == state, MANAGED)

    def bring_to(self, target: str) -> None:
        """Configure, activate or deactivate it."""
        state = self.state
        if state == UNCONFIGURED != target:
            self._call("configure_controller", name=self._name)
        if target == ACTIVE != state:
            self._switch(activate=[self._name])
        elif target != ACTIVE == state:
            self._switch(deactivate=[self._name])

    def configure_anew(self, target: str = "", between: Callable[[], None] = lambda: None) -> None:
        """Deactivate it with those chained to it, configure it, and activate them again.

        After a failure on this way the next one activates those that were active before.
        """
        controllers = self._controllers()
        state = self._state(controllers)
        target = target or state
        if state == ACTIVE:
            self._chain = self._active_chain(controllers)
            self._switch(deactivate=self._chain)
        between()
        self._call("configure_controller", name=self._name)
        if target == ACTIVE:
            self._switch(activate=self._chain or [self._name])

    def _state(self, controllers: Mapping[str, Any]) -> str:
        if self._name not in controllers:
            known = ", ".join(sorted(controllers)) or "none"
            raise StudyError(
                f"the {CONTROLLER_MANAGER} has no controller {self._name}; it has {known}"
            )
        return str(controllers[self._name].state)

    def _active_chain(self, controllers: Mapping[str, Any]) -> list[str]:
        """Return it, if it is active, and the active ones that write to it, through others."""
        if self._state(controllers) != ACTIVE:
            return []
        chain = [self._name]
        for name in chain:
            chain += [
                other
                for other, found in controllers.items()
                if found.state == ACTIVE
                and other not in chain
                and any(link.name == name for link in found.chain_connections)
            ]
        return chain

    def _controllers(self) -> dict[str, Any]:
        answer = self._call("list_controllers")
        return {controller.name: controller for controller in answer.controller}

    def _switch(self, activate: Sequence[str] = (), deactivate: Sequence[str] = ()) -> None:
        kind, _ = self._services["switch_controller"]
        self._call(
            "switch_controller",
            activate_controllers=list(activate),
            deactivate_controllers=list(deactivate),
            strictness=kind.Request.STRICT,
        )

    def _call(self, service: str, **request: Any) -> Any:
        kind, client = self._services[service]
        answer = self._tuner.call(client, kind.Request(**request), CONTROLLER_MANAGER, CHANGE)
        if reason := refusal(answer, {}):
            asked = ", ".join(f"{key} {value}" for key, value in request.items() if value)
            raise RefusedError(f"{client.srv_name} refused {asked}: {reason}")
        return answer
