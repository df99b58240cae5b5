"""What an open backend has of a study's nodes."""

from collections.abc import Callable
from typing import NamedTuple

from bo_tuner.backends.layers.suspension import Suspension
from bo_tuner.backends.ros.bringup import Bringup
from bo_tuner.backends.ros.parameters.events import Values
from bo_tuner.backends.ros.parameters.previous import PreviousParameters
from bo_tuner.backends.ros.procedure import Procedure
from bo_tuner.backends.ros.safe_state import SafeState
from bo_tuner.backends.ros.started_nodes import StartedNodes
from bo_tuner.backends.ros.study_client import StudyClient
from bo_tuner.backends.ros.tuner_node import TunerNode
from bo_tuner.study.study import Study


class Opened(NamedTuple):
    """What an open backend has.

    Attributes
    ----------
    held
        Values of the parameters that the study does not set, by node.
    procedure
        Performs runs; None where a node does so itself.
    previous
        What attached nodes get back in the end; None of started ones.
    look
        Checks for an interruption and a suspension, not the nodes.
    """

    study: Study
    tuner: TunerNode
    client: StudyClient
    started: StartedNodes
    bringup: Bringup
    suspension: Suspension
    held: Values
    procedure: Procedure | None
    previous: PreviousParameters | None
    safe_state: SafeState
    look: Callable[[], None]
