"""Where evaluations run: over ROS on separate nodes, or on plain objects within the process."""

from collections.abc import Mapping
from typing import Protocol

from bo_tuner.trials import Outcome

ROS, IN_PROCESS = "ros", "inprocess"
BACKENDS = (ROS, IN_PROCESS)
"""Names of the backends, on the command line and on record; the first is the default."""

Assignments = Mapping[str, Mapping[str, int | float]]
"""Parameter values by node key of the study, then by parameter name."""


class Backend(Protocol):
    """Runs evaluations of a study, one at a time, between `open` and `close`."""

    name: str

    def open(self) -> None:
        """Get ready to run evaluations.

        Raises
        ------
        BackendError
            If the nodes or objects cannot be had.
        """

    def run_cut(self, assignments: Assignments) -> Outcome:
        """Set parameters, run one evaluation, and collect its metrics.

        A fault of a node or of the simulation is an outcome, not an exception.
        """

    def close(self) -> None:
        """Let go of everything that `open` took; may be called more than once."""
