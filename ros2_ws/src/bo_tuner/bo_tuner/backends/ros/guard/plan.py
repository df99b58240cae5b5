"""What a guard holds of a study: the safe parameters, the stop messages, the abort condition."""

import hashlib
import json
import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

from rclpy.expand_topic_name import expand_topic_name

from bo_tuner.errors import BackendError, StudyError
from bo_tuner.study.guarding import TIMEOUT, Guarding
from bo_tuner.study.nodes import NodeSpec
from bo_tuner.study.publishing import Topic
from bo_tuner.study.run import WALL
from bo_tuner.study.safe_values import safe_values
from bo_tuner.study.signals import Signal
from bo_tuner.study.step_values import filled_after
from bo_tuner.study.study import Study

PATIENCE = "BO_TUNER_GUARD_TIMEOUT"
"""Environment variable with the least time [s] that a guard waits for a heartbeat: how busy a
computer may be is no matter of a study."""
GIVE_UP = 600.0
"""Time [s] for which a guard whose tuner has ended tries to leave the nodes safe."""
WIDEST = 1.5
"""Time [s] to which late heartbeats widen it at most, unless somebody has named the time."""


class Patience(NamedTuple):
    """For how long [s] a guard waits for a heartbeat: at first, and at most if some come late."""

    least: float
    most: float


def patience(study: Study) -> Patience:
    """Return the time without a heartbeat after which a guard acts."""
    of_study = patience_of(study.guard)
    given = os.environ.get(PATIENCE, "")
    if not given:
        return of_study
    try:
        least = max(patience_of(Guarding(timeout=float(given))).least, of_study.least)
    except (ValueError, StudyError) as error:
        raise BackendError(f"{PATIENCE}: {error}") from error
    return Patience(least, least)


def patience_of(guarding: Guarding) -> Patience:
    """Return what a study says of it; where it says nothing, late heartbeats widen it."""
    if guarding.timeout is None:
        return Patience(TIMEOUT, WIDEST)
    return Patience(guarding.timeout, guarding.timeout)


@dataclass(frozen=True)
class Plan:
    """What a guard holds.

    Attributes
    ----------
    name : str
        Name of the study.
    nodes : mapping from str to str
        Names of the nodes by their keys in the study, relative to the namespace or absolute.
    safe : mapping
        By node key the parameters that the nodes are to be left with.
    stop : tuple of Topic
        The messages that stop the machine: those at the head of ``after``, of a stream the last.
    actions : tuple of str
        Actions whose goals are cancelled.
    abort_when : str
        Condition on signals at which a run must end; empty for none.
    signals : mapping from str to Signal
        The study's signals.
    clock : str
        Clock of the runs, by which the condition and the stamps of messages go.
    configured : mapping from str to NodeSpec
        By their keys the nodes that take some of these only when they are configured.
    """

    name: str
    nodes: Mapping[str, str]
    safe: Mapping[str, Mapping[str, object]]
    stop: tuple[Topic, ...] = ()
    actions: tuple[str, ...] = ()
    abort_when: str = ""
    signals: Mapping[str, Signal] | None = None
    clock: str = WALL
    configured: Mapping[str, NodeSpec] = field(default_factory=dict)

    @classmethod
    def of(cls, study: Study, *, attached: bool = True) -> "Plan":
        """Return what is to be held of a study.

        What nodes that the tuner has started take only while they start it alone can give them;
        they end with it.
        """
        nodes = {key: spec.node for key, spec in study.nodes.items()}
        names = study.start_names
        safe = {
            key: {n: v for n, v in of_node.items() if attached or n not in names.get(key, ())}
            for key, of_node in safe_values(study).items()
        }
        configured = {key: study.nodes[key] for key in names if attached}
        run = study.run
        if run is None:
            return cls(study.name, nodes, safe, configured=configured)
        steps = [step for _, step in run.steps]
        # A bag that is played is in a time that nobody else has, and moves nothing.
        plays = run.play is not None
        return cls(
            study.name,
            nodes,
            safe,
            tuple(
                topic
                for step in filled_after(run, study.safe_parameters)
                if step.publish is not None
                for topic in step.publish.ending(study.folder)
            ),
            tuple(dict.fromkeys(s.send_goal.action for s in steps if s.send_goal is not None)),
            "" if plays else run.abort_when,
            study.signals,
            WALL if plays else run.clock,
            configured,
        )

    @classmethod
    def of_values(cls, study: Study, values: Mapping[str, Mapping[str, object]]) -> "Plan":
        """Return a plan to give nodes back what they have, by node key; there is no run to stop."""
        nodes = {key: study.nodes[key] for key in values}
        configured = {key: spec for key, spec in nodes.items() if spec.reconfigure}
        names = {key: spec.node for key, spec in nodes.items()}
        return cls(study.name, names, values, configured=configured)

    @property
    def digest(self) -> str:
        """A digest: plans of two studies that hold the same are equal, whatever else they say."""
        held = (self.nodes, self.safe, self.stop, self.actions, self.abort_when, self.clock)
        used = {} if not self.abort_when else self.signals
        anew = [{k: spec.reconfigure for k, spec in self.configured.items()}]
        text = json.dumps([held, used, anew], sort_keys=True, default=repr)
        return hashlib.sha256(text.encode()).hexdigest()

    def full_names(self, namespace: str) -> list[str]:
        """Return the full names of the nodes, seen from a namespace."""
        return sorted(expand_topic_name(name, "guard", namespace) for name in self.nodes.values())
