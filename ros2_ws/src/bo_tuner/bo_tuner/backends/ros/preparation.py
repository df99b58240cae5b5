"""The steps of a run, looked for among the running nodes before anything is performed."""

from collections.abc import Iterator
from functools import partial

from rclpy.node import Node

from bo_tuner.backends.ros.clock import RunClock, SimClock, WallClock
from bo_tuner.backends.ros.goals import Goal
from bo_tuner.backends.ros.own_topics import OwnTopic
from bo_tuner.backends.ros.parameters.nodes import NodeParameters
from bo_tuner.backends.ros.play.play_clock import PlayClock
from bo_tuner.backends.ros.play.player import Player
from bo_tuner.backends.ros.publication import Publication
from bo_tuner.backends.ros.steps import (
    CONNECT_TIMEOUT,
    LifecycleChange,
    ParameterChange,
    PreparedStep,
    ServiceCall,
)
from bo_tuner.backends.ros.streams import Stream
from bo_tuner.backends.ros.ticks import Ticks, WallTicks
from bo_tuner.backends.ros.tuner_node import NODE_NAME, TunerNode
from bo_tuner.codec.findings import under
from bo_tuner.errors import KeyPath, StudyError
from bo_tuner.study.publishing import Publish
from bo_tuner.study.run import AFTER, BEFORE, SIM, START
from bo_tuner.study.safe_values import safe_in_braces
from bo_tuner.study.step_values import filled_step
from bo_tuner.study.steps import Step
from bo_tuner.study.study import Study


class Preparation:
    """Makes the steps of a study's run ready.

    Attributes
    ----------
    topics
        What the steps publish, by topic.
    """

    def __init__(
        self,
        study: Study,
        tuner: TunerNode,
        clock: RunClock,
        *,
        attached: bool,
        listener: Node | None = None,
        ticks: Ticks | None = None,
        parameters: NodeParameters | None = None,
    ) -> None:
        self._study = study
        self._tuner = tuner
        self._clock = clock
        self._attached = attached
        self._listener = listener
        self._parameters = parameters
        self._ticks: Ticks = WallTicks(clock) if ticks is None else ticks
        self.topics: dict[str, OwnTopic] = {}

    def play_clock(self) -> PlayClock:
        """Make the clock of a run that plays a bag, by which what is prepared next goes."""
        clock = PlayClock(self._tuner, self.topics, self._listener)
        self._clock, self._ticks = clock, WallTicks(clock)
        return clock

    def prepare(self, path: KeyPath, step: Step) -> PreparedStep | Goal | Stream | Player | None:
        """Return what a step needs: a goal, a stream, what is performed otherwise, or None."""
        with under(*path):
            if step.call is not None:
                return ServiceCall.prepare(self._tuner, step.call, path)
            if step.publish is not None:
                return self._publication(step.publish, path[1])
            if step.set is not None and self._parameters is not None:
                return ParameterChange(self._parameters, step.set, path)
            if step.lifecycle is not None:
                return LifecycleChange.prepare(self._tuner, step.lifecycle)
            if step.send_goal is not None:
                with under("send_goal"):
                    return Goal(self._tuner, step.send_goal, CONNECT_TIMEOUT)
            if step.play is not None and isinstance(self._clock, PlayClock):
                study = self._study
                with under("play"):
                    return Player(
                        self._tuner,
                        step.play,
                        study.folder,
                        study.signals,
                        self.topics,
                        self._clock,
                        self._listener,
                    )
            for key in step.restarts:
                self._check_restart(key)
        return None

    def _publication(self, publish: Publish, phase: str | int) -> Publication | Stream:
        # What only stops the machine after a run may be the controller's own in it.
        listener = self._listener if phase in (BEFORE, START) else None
        publications = []
        for path, topic in zip(publish.paths, publish.published, strict=True):
            with under("publish", *path):
                publications.append(
                    Publication.prepare(
                        self._tuner, topic, self._clock, self.topics, listener, phase == AFTER
                    )
                )
        if not publish.streams:
            return publications[0]
        run, folder = self._study.run, self._study.folder
        longest = 0.0 if run is None else run.longest
        return Stream(self._tuner, publish, publications, self._ticks, folder, longest)

    def _check_restart(self, key: str) -> None:
        spec = self._study.nodes[key]
        problem = ""
        if self._attached:
            problem = f"{key} is attached; only a node that the tuner has started can be restarted"
        elif not spec.is_started:
            problem = f"the study does not say how to start {key}"
        if problem:
            raise StudyError(problem, ("restart",))


def run_problems(study: Study, tuner: TunerNode, *, attached: bool) -> Iterator[StudyError]:
    """Yield every mistake that the preparation of a study's run shows; nothing is performed."""
    if study.run is None:
        return
    wait = partial(tuner.wait_until, timeout=CONNECT_TIMEOUT)
    if study.run.clock == SIM and study.run.play is None:
        # A clock takes its messages itself, so its node is in no executor.
        node = Node(f"{NODE_NAME}_clock", context=tuner.context, start_parameter_services=False)
        try:
            SimClock(node).connect(wait)
        except StudyError as error:
            yield error.under("run", "clock")
        finally:
            node.destroy_node()
    preparation = Preparation(study, tuner, WallClock(), attached=attached)
    if study.run.play is not None:
        preparation.play_clock()
    nominal = safe_in_braces(study)
    try:
        for path, step in study.run.steps:
            try:
                prepared = preparation.prepare(path, filled_step(step, nominal))
            except StudyError as error:
                yield error
                continue
            if isinstance(prepared, (Goal, Player)):
                prepared.close()
    finally:
        # They would be taken for those of somebody else.
        for topic in preparation.topics.values():
            tuner.node.destroy_publisher(topic.publisher)
