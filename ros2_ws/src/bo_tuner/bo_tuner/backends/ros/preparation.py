"""The steps of a run, looked for among the running nodes before anything is performed."""

from collections.abc import Iterator
from functools import partial

from rclpy.node import Node

from bo_tuner.backends.ros.clock import RunClock, SimClock, WallClock
from bo_tuner.backends.ros.goals import Goal
from bo_tuner.backends.ros.own_topics import OwnTopic
from bo_tuner.backends.ros.steps import (
    CONNECT_TIMEOUT,
    LifecycleChange,
    PreparedStep,
    Publication,
    ServiceCall,
)
from bo_tuner.backends.ros.tuner_node import NODE_NAME, TunerNode
from bo_tuner.errors import KeyPath, StudyError
from bo_tuner.study.building import under
from bo_tuner.study.run import AFTER, BEFORE, SIM, START
from bo_tuner.study.step_contexts import filled_step
from bo_tuner.study.steps import Step
from bo_tuner.study.study import Study


class Preparation:
    """Makes the steps of a study's run ready.

    Parameters
    ----------
    study
        The study.
    tuner
        The tuner's node.
    clock
        Stamps what is published.
    attached
        Whether the nodes ran already, so that none can be restarted.
    listener
        Hears whether others publish what the steps ahead of the end of a run do; None not to
        listen.

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
    ) -> None:
        self._study = study
        self._tuner = tuner
        self._clock = clock
        self._attached = attached
        self._listener = listener
        self.topics: dict[str, OwnTopic] = {}

    def prepare(self, path: KeyPath, step: Step) -> PreparedStep | Goal | None:
        """Return what a step needs: a goal, something else to perform, or None if it needs nothing.

        Raises
        ------
        StudyError
            If a topic, service, action or node is not there, or not as the study says; from the
            root of the study.
        """
        with under(*path):
            if step.call is not None:
                return ServiceCall.prepare(self._tuner, step.call, path)
            if step.publish is not None:
                phase = path[1]
                # What only stops the machine after a run may be the controller's own in it.
                listener = self._listener if phase in (BEFORE, START) else None
                return Publication.prepare(
                    self._tuner, step.publish, self._clock, self.topics, listener, phase == AFTER
                )
            if step.lifecycle is not None:
                return LifecycleChange.prepare(self._tuner, step.lifecycle)
            if step.send_goal is not None:
                with under("send_goal"):
                    return Goal(self._tuner, step.send_goal, CONNECT_TIMEOUT)
            if step.restart:
                self._check_restart(step.restart)
        return None

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
    """Yield every mistake in the run of a study, as of `Preparation`; nothing is performed."""
    if study.run is None:
        return
    wait = partial(tuner.wait_until, timeout=CONNECT_TIMEOUT)
    if study.run.clock == SIM:
        # A clock takes its messages itself, so its node is in no executor.
        node = Node(f"{NODE_NAME}_clock", context=tuner.context, start_parameter_services=False)
        try:
            SimClock(node).connect(wait)
        except StudyError as error:
            yield error.under("run", "clock")
        finally:
            node.destroy_node()
    preparation = Preparation(study, tuner, WallClock(), attached=attached)
    contexts = study.context_space()
    nominal = contexts.to_dict(contexts.nominal())
    try:
        for path, step in study.run.steps:
            try:
                prepared = preparation.prepare(path, filled_step(step, nominal))
            except StudyError as error:
                yield error
                continue
            if isinstance(prepared, Goal):
                prepared.close()
    finally:
        # They would be taken for those of somebody else.
        for topic in preparation.topics.values():
            tuner.node.destroy_publisher(topic.publisher)
