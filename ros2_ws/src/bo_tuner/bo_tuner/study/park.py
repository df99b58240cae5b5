"""The parameters with which a machine is safe while no run is performed."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from bo_tuner.codec import checks
from bo_tuner.errors import StudyError
from bo_tuner.trials import Value


@dataclass(frozen=True, kw_only=True)
class Park:
    """What the nodes are set to while no run is performed.

    Attributes
    ----------
    parameters : mapping from str to value
        Values of tuned parameters of the study; the others have their default.
    between_runs : bool
        Whether also between two runs, and while a run is prepared; else in a pause, after a run
        that failed, and at the end.
    """

    parameters: Mapping[str, Value] = field(default_factory=dict)
    between_runs: bool = False

    def __post_init__(self) -> None:
        """Check the fields; the study checks the values."""
        checks.boolean(self.between_runs, "between_runs")
        if not isinstance(self.parameters, Mapping):
            raise StudyError(
                f"expected values by parameter, found {checks.show(self.parameters)}",
                ("parameters",),
            )
