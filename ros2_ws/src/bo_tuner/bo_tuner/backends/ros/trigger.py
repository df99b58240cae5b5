"""Evaluations of nodes that are triggered, and report their metrics themselves."""

import time
from functools import partial

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.client import Client
from rclpy.qos import QoSProfile, QoSReliabilityPolicy
from std_srvs.srv import Trigger

from bo_tuner.backends.ros.decoding import UnreadableError, decode
from bo_tuner.backends.ros.errors import DisturbedError, LostError, SilentError
from bo_tuner.backends.ros.parameters.nodes import NodeParameters
from bo_tuner.backends.ros.results import RunResults
from bo_tuner.backends.ros.tuner_node import TunerNode
from bo_tuner.errors import BackendError
from bo_tuner.metrics.collect import STATUS_OK
from bo_tuner.study.metrics import ReportedMetric
from bo_tuner.study.parts import Trigger as TriggerSpec
from bo_tuner.study.study import Study

RESULT_QOS = QoSProfile(depth=50, reliability=QoSReliabilityPolicy.RELIABLE)


class TriggeredRun:
    """Triggers an evaluation, and hears what the nodes say of it.

    Attributes
    ----------
    results : RunResults
        What the nodes say of the present evaluation.
    service : Client, optional
        The trigger; None if the study has none.
    """

    def __init__(self, study: Study, tuner: TunerNode, parameters: NodeParameters) -> None:
        self._study = study
        self._tuner = tuner
        self._parameters = parameters
        self.results = RunResults()
        self.service: Client | None = None
        for key, spec in study.nodes.items():
            if spec.result:
                topic = of_node(spec.node, spec.result)
                tuner.node.create_subscription(
                    DiagnosticArray, topic, partial(self._on_result, key), RESULT_QOS, raw=True
                )
        if study.trigger is not None:
            node = study.nodes[study.trigger.node].node
            name = of_node(node, study.trigger.service)
            self.service = tuner.node.create_client(Trigger, name)

    def run(self) -> dict[str, dict[str, object]]:
        """Start an evaluation and return its results by node key."""
        trigger = self._study.trigger
        if trigger is None or self.service is None:
            raise BackendError("the study has no trigger")
        deadline = time.monotonic() + trigger.timeout
        self.results.identify(self._start(trigger, self.service, deadline))
        return self._await_results(trigger, deadline)

    def _start(self, trigger: TriggerSpec, service: Client, deadline: float) -> str:
        name = self._study.nodes[trigger.node].node
        while True:
            response = self._tuner.call(service, Trigger.Request(), name)
            if response.success:
                return str(response.message)
            # Right after the start the nodes may not have found each other yet.
            if time.monotonic() > deadline:
                raise LostError(f"{name} does not start a test run: {response.message}")
            self._tuner.spin_once()

    def _await_results(self, trigger: TriggerSpec, deadline: float) -> dict[str, dict[str, object]]:
        metrics = self._study.metrics.values()
        awaited = {trigger.node} | {m.node for m in metrics if isinstance(m, ReportedMetric)}
        while True:
            if self.results.problem:
                raise DisturbedError(self.results.problem)
            said = self.results.said
            if any(pairs["status"] != STATUS_OK for pairs in said.values()):
                # A node may have failed the evaluation for want of another one.
                for key in sorted(awaited - said.keys()):
                    self._parameters.expect_answer(key)
                return said
            if awaited <= said.keys():
                return said
            if time.monotonic() > deadline:
                silent = ", ".join(sorted(awaited - said.keys()))
                raise SilentError(
                    f"no result of the test run from {silent} within {trigger.timeout:g} s"
                )
            self._tuner.spin_once()

    def _on_result(self, key: str, data: bytes) -> None:
        try:
            message = decode(data, DiagnosticArray)
        except UnreadableError as error:
            self.results.add_unreadable(f"{self._study.nodes[key].node}: a result {error}")
            return
        for status in message.status:
            pairs: dict[str, object] = {item.key: item.value for item in status.values}
            failed = status.level == DiagnosticStatus.ERROR
            pairs.setdefault("status", "failed" if failed else STATUS_OK)
            pairs.setdefault("reason", status.message)
            self.results.add(key, pairs)


def of_node(node: str, name: str) -> str:
    """Expand ``~/name`` for a node other than this one."""
    return f"{node}/{name.removeprefix('~/')}" if name.startswith("~/") else name
