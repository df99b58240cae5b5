"""The tuner's ROS node: diagnostics, trial results, numbers to plot, and services.

It takes no part in the control loop and never blocks the run: trial results are published when a
trial has ended, and a separate thread serves a timer of 1 Hz and the services.
"""

import threading
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.clock import Clock, ClockType
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from std_msgs.msg import Float64
from std_srvs.srv import SetBool, Trigger

from bo_tuner.backends.ros.tuner_node import LIVE_NODE
from bo_tuner.monitoring import diagnostics
from bo_tuner.monitoring.control import RunControl
from bo_tuner.monitoring.status import RunStatus
from bo_tuner.optimizers.ranking import Candidate
from bo_tuner.study.limits import tightest
from bo_tuner.study.study import Study
from bo_tuner.trials import Trial, TrialState
from bo_tuner.tuning.observer import RunObserver
from bo_tuner.tuning.question import Given, Reply

PERIOD = 1.0
SPIN_PERIOD = 1.0
DIAGNOSTICS = "/diagnostics"
"""The same topic in all namespaces, as REP-107 requires."""
HEADLINES = ("objective", "best_objective", "probability_feasible", "worst_case")
LEVELS = (DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR)


class LiveNode(RunObserver):
    """ROS node that publishes the state of a run, and serves requests to it and answers."""

    def __init__(
        self,
        context: Context,
        study: Study,
        folder: Path,
        status: RunStatus,
        control: RunControl,
    ) -> None:
        self._study = study
        self._folder = folder
        self._status = status
        self._control = control
        self._node = Node(
            LIVE_NODE, context=context, enable_rosout=False, start_parameter_services=False
        )
        self._diagnostics = self._node.create_publisher(DiagnosticArray, DIAGNOSTICS, 10)
        # A late subscriber gets the results of all trials, but only the latest numbers, since these
        # have no time stamp.
        self._results = self._node.create_publisher(
            DiagnosticArray, "~/trial_result", _latched(study.budget.trials)
        )
        self._headlines = {
            name: self._node.create_publisher(Float64, f"~/{name}", _latched(1))
            for name in HEADLINES
        }
        self._node.create_service(SetBool, "~/pause", self._on_pause)
        self._node.create_service(Trigger, "~/finish", self._on_finish)
        self._node.create_service(Trigger, "~/abort", self._on_abort)
        for reply in (Reply.ACCEPT, Reply.REFUSE):
            self._node.create_service(Trigger, f"~/{reply}", partial(self._on_answer, reply))
        # Not the node's own clock: simulated time may stand still.
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._node.create_timer(PERIOD, self._publish_diagnostics, clock=steady)
        self._executor = SingleThreadedExecutor(context=context)
        self._executor.add_node(self._node)
        self._stop = threading.Event()
        self.thread = threading.Thread(target=self._spin, name="live", daemon=True)
        self.thread.start()

    def close(self) -> None:
        """Publish the last state and destroy the node."""
        self._stop.set()
        self._executor.wake()
        self.thread.join()
        self._publish_diagnostics()
        self._executor.shutdown()
        self._node.destroy_node()

    def recall(self, trials: Sequence[Trial], incumbent: Candidate | None) -> None:
        """Publish the results of the recorded trials."""
        for trial in trials:
            self._publish_result(trial, incumbent if trial is trials[-1] else None)

    def trial(self, trial: Trial, incumbent: Candidate | None) -> None:
        """Publish the result of a trial."""
        self._publish_result(trial, incumbent)

    def _publish_result(self, trial: Trial, incumbent: Candidate | None) -> None:
        status = diagnostics.trial_result(self._study, trial, incumbent, str(self._folder))
        self._results.publish(self._array(status))
        for name, value in self._numbers(trial, incumbent).items():
            self._headlines[name].publish(Float64(data=float(value)))

    def _numbers(self, trial: Trial, incumbent: Candidate | None) -> Mapping[str, float]:
        numbers = {}
        mean = trial.mean(self._study.objective.metric)
        if trial.state is TrialState.COMPLETE and mean is not None:
            numbers["objective"] = mean
        if (tightest_constraint := tightest(self._study, trial)) is not None:
            numbers["worst_case"] = tightest_constraint[1].value
        if incumbent is not None:
            numbers["probability_feasible"] = incumbent.feasibility
            if incumbent.believed_feasible:
                numbers["best_objective"] = incumbent.objective
        return numbers

    def _publish_diagnostics(self) -> None:
        now = self._status.now
        statuses = (diagnostics.progress, diagnostics.surrogate, diagnostics.safety)
        self._diagnostics.publish(self._array(*(make(self._study, now) for make in statuses)))

    def _array(self, *statuses: diagnostics.Status) -> DiagnosticArray:
        message = DiagnosticArray()
        message.header.stamp = self._node.get_clock().now().to_msg()
        message.status = [
            DiagnosticStatus(
                level=LEVELS[status.level],
                name=status.name,
                message=status.message,
                hardware_id=self._study.name,
                values=[KeyValue(key=key, value=value) for key, value in status.values.items()],
            )
            for status in statuses
        ]
        return message

    def _on_pause(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        response.success = True
        response.message = self._control.pause(request.data)
        return response

    def _on_finish(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        response.success = True
        response.message = self._control.finish()
        return response

    def _on_abort(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        response.success = True
        response.message = self._control.abort("the service ~/abort")
        return response

    def _on_answer(
        self, reply: Reply, _request: Trigger.Request, response: Trigger.Response
    ) -> Trigger.Response:
        given = Given(reply, f"service ~/{reply}")
        response.success, response.message = self._control.answer(given)
        return response

    def _spin(self) -> None:
        while not self._stop.is_set():
            self._executor.spin_once(timeout_sec=SPIN_PERIOD)


def _latched(depth: int) -> QoSProfile:
    return QoSProfile(
        depth=depth,
        reliability=ReliabilityPolicy.RELIABLE,
        durability=DurabilityPolicy.TRANSIENT_LOCAL,
    )
