"""Performs the run of a study on nodes that know nothing of the tuner."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from rclpy.client import Client
from rclpy.publisher import Publisher
from rclpy.qos import QoSDurabilityPolicy, QoSProfile

from bo_tuner.backends.ros.messages import interface_class, make_message
from bo_tuner.backends.ros.signals import SignalRecorder
from bo_tuner.backends.ros.study_client import NODE_NAME, StudyClient
from bo_tuner.errors import KeyPath, StudyError
from bo_tuner.metrics.collect import one_line
from bo_tuner.metrics.recording import NOTHING_RECORDED, FailedRunError, Recording
from bo_tuner.numerics.expressions import Expression
from bo_tuner.study import checks
from bo_tuner.study.run import Call, Publish, Run, Step
from bo_tuner.study.signals import expression
from bo_tuner.study.study import Study

CONNECT_TIMEOUT = 5.0
"""Time [s] to find a topic, a service, or the subscribers of a message."""
POLL_PERIOD = 0.01
"""Time [s] between two looks at the signals: how late a run ends or is aborted at most."""
OVERLAP = 0.5
"""Time [s] of a run that a condition is judged on again, for messages that come in late."""


class Procedure:
    """Runs of a study, one after the other.

    Parameters
    ----------
    study
        The study, for its signals.
    run
        What makes up a run.
    client
        The tuner's node.

    Attributes
    ----------
    recording : Recording
        What was recorded of the last run.

    Raises
    ------
    StudyError
        If a topic or service is not there, or not of the type that the study needs.
    """

    def __init__(self, study: Study, run: Run, client: StudyClient) -> None:
        self._run = run
        self._study = study
        self._client = client
        self._recorder = SignalRecorder(client.context, study.signals)
        self.recording = NOTHING_RECORDED
        self._abort = self._condition(self._run.abort_when)
        self._end = self._condition(self._run.end.when)
        self._actions: dict[KeyPath, _Publication | _Service] = {}
        self._publishers: dict[str, Publisher] = {}
        self._is_recording = False
        self._began = 0.0
        self._judged = 0.0
        try:
            for path, step in self._run.steps:
                try:
                    self._prepare(path, step)
                except StudyError as error:
                    raise error.under(*path) from None
            self._recorder.connect(self._wait_until)
        except BaseException:
            self.close()
            raise

    def run(self) -> None:
        """Run once; `recording` has the signals then.

        Raises
        ------
        FailedRunError
            If the run does not count: a step is refused, a condition does not hold in time or says
            that the run is to be aborted, or signals are not whole.
        LostError
            If a service does not answer.
        """
        self.recording = NOTHING_RECORDED
        try:
            self._perform("before", self._run.before)
            self.recording = self._record()
        except FailedRunError as failure:
            try:
                self._perform("after", self._run.after)
            except FailedRunError as further:
                raise FailedRunError(f"{failure}; and after it: {further}") from None
            raise
        self._perform("after", self._run.after)
        self.recording.check(self._study.signals)

    def close(self) -> None:
        """Hear no more."""
        self._recorder.close()

    def _record(self) -> Recording:
        run = self._run
        self._recorder.begin()
        self._began = time.monotonic()
        self._judged = 0.0
        self._is_recording = True
        try:
            self._perform("start", run.start)
            if run.end.after is not None:
                self._watch_until(run.end.after)
                return self._recorder.recording(run.end.after)
            ended = self._watch_until(run.timeout, ends=True)
            if ended is None:
                raise FailedRunError(
                    f"the run does not end: {checks.quoted(run.end.when)} does not hold within "
                    f"{run.timeout:g} s"
                )
            return self._recorder.recording(ended)
        finally:
            self._is_recording = False

    def _watch_until(self, end: float, ends: bool = False) -> float | None:
        """Look on until `end` [s]; with `ends`, return when before it the run's condition held."""
        begin = self._now
        while True:
            now = self._now
            self._recorder.poll()
            seen = min(now, end)
            since = max(self._judged - OVERLAP, 0.0)
            aborted = self._holds(self._abort, since, seen)
            if aborted is not None:
                raise FailedRunError(
                    f"aborted at {aborted:.3f} s: {checks.quoted(self._run.abort_when)}"
                )
            ended = self._holds(self._end, max(since, begin), seen) if ends else None
            if ended is not None or now >= end:
                return ended
            self._judged = seen
            self._client.spin_once(min(POLL_PERIOD, end - now))

    @property
    def _now(self) -> float:
        """Time since the start of the run [s]."""
        return time.monotonic() - self._began

    def _holds(self, condition: Expression | None, since: float, now: float) -> float | None:
        """Return the first time [s] from `since` on at which a condition holds, if there is one."""
        if condition is None:
            return None
        recording = self._recorder.recording(now, since)
        names = condition.names & self._study.signals.keys()
        if any(len(recording.signals[name].time) == 0 for name in names):
            return None
        times, values = recording.sample(condition)
        held = np.flatnonzero(np.isfinite(values) & (values != 0.0) & (times >= since))
        return float(times[held[0]]) if len(held) else None

    def _perform(self, phase: str, steps: Sequence[Step]) -> None:
        for index, step in enumerate(steps):
            if step.wait is not None:
                if self._is_recording:
                    self._watch_until(self._now + step.wait)
                else:
                    self._sleep(step.wait)
            else:
                self._actions["run", phase, index].perform()

    def _sleep(self, period: float) -> None:
        deadline = time.monotonic() + period
        while (left := deadline - time.monotonic()) > 0.0:
            self._client.spin_once(min(POLL_PERIOD, left))

    def _wait_until(self, condition: Callable[[], bool]) -> bool:
        deadline = time.monotonic() + CONNECT_TIMEOUT
        while not condition():
            if time.monotonic() > deadline:
                return False
            self._client.spin_once(POLL_PERIOD)
        return True

    def _condition(self, text: str) -> Expression | None:
        return expression(text, self._study.signals) if text else None

    def _prepare(self, path: KeyPath, step: Step) -> None:
        if step.call is not None:
            self._actions[path] = self._service(path, step.call)
        elif step.publish is not None:
            self._actions[path] = self._publication(step.publish)

    def _service(self, path: KeyPath, call: Call) -> "_Service":
        node = self._client.node
        name = node.resolve_service_name(call.service)
        if not self._wait_until(lambda: name in dict(node.get_service_names_and_types())):
            names = sorted(n for n, _ in node.get_service_names_and_types())
            raise StudyError(
                f"there is no service {name}; {checks.suggestion(name, names)}", ("call", "service")
            )
        try:
            cls = interface_class(dict(node.get_service_names_and_types())[name][0])
        except StudyError as error:
            raise error.under("call", "service") from None
        try:
            request = make_message(cls.Request, call.request)
        except StudyError as error:
            raise error.under("call", "request") from None
        return _Service(self._client, node.create_client(cls, name), request, path)

    def _publication(self, publish: Publish) -> "_Publication":
        node = self._client.node
        topic = node.resolve_topic_name(publish.topic)

        def others() -> list[Any]:
            found = node.get_subscriptions_info_by_topic(topic)
            # The tuner's own nodes, which record the topic, do not count.
            return [info for info in found if not info.node_name.startswith(NODE_NAME)]

        if not self._wait_until(lambda: bool(others())):
            names = sorted(n for n, _ in node.get_topic_names_and_types() if n != topic)
            raise StudyError(
                f"nothing subscribes to {topic}; {checks.suggestion(topic, names)}",
                ("publish", "topic"),
            )
        found = others()
        if publish.type not in ("", found[0].topic_type):
            raise StudyError(
                f"{topic} carries {found[0].topic_type}, expected {publish.type}",
                ("publish", "type"),
            )
        try:
            cls = interface_class(found[0].topic_type)
        except StudyError as error:
            raise error.under("publish", "topic") from None
        try:
            make_message(cls, publish.message)
        except StudyError as error:
            raise error.under("publish", "message") from None
        durability = QoSDurabilityPolicy.VOLATILE
        if any(i.qos_profile.durability == QoSDurabilityPolicy.TRANSIENT_LOCAL for i in found):
            durability = QoSDurabilityPolicy.TRANSIENT_LOCAL
        publisher = self._publishers.get(topic)
        if publisher is None:
            qos = QoSProfile(depth=10, durability=durability)
            publisher = self._publishers[topic] = node.create_publisher(cls, topic, qos)
        publication = _Publication(self._client, publisher, others, publish, cls, self._wait_until)
        try:
            publication.wait()
        except FailedRunError as error:
            raise StudyError(str(error), ("publish", "topic")) from None
        return publication


@dataclass(frozen=True)
class _Service:
    """A call, ready to be made."""

    client: StudyClient
    service: Client
    request: Any
    path: KeyPath

    def perform(self) -> None:
        _, phase, index = self.path
        response = self.client.call(
            self.service, self.request, f"the node that run.{phase}[{index}] calls"
        )
        if getattr(response, "success", True) is False:
            reason = one_line(getattr(response, "message", "")) or "no reason given"
            raise FailedRunError(f"{self.service.srv_name} refused: {reason}")


@dataclass(frozen=True)
class _Publication:
    """A message, ready to be published."""

    client: StudyClient
    publisher: Publisher
    others: Callable[[], list[Any]]
    publish: Publish
    cls: Any
    wait_until: Callable[[Callable[[], bool]], bool]

    def wait(self) -> None:
        """Wait until those who subscribe are connected, as what is published earlier is lost."""

        def connected() -> bool:
            count = len(self.others())
            return 0 < count <= self.publisher.get_subscription_count()

        if not connected() and not self.wait_until(connected):
            raise FailedRunError(f"nothing subscribes to {self.publisher.topic_name}")

    def perform(self) -> None:
        self.wait()
        stamp = self.client.node.get_clock().now().to_msg()
        self.publisher.publish(make_message(self.cls, self.publish.message, stamp))
