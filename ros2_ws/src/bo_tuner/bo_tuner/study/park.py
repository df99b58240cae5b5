"""The parameters with which a machine is safe while no run is performed."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated

from bo_tuner.codec.checks import ParameterValue
from bo_tuner.codec.reading import Section
from bo_tuner.codec.rules import Expected


@dataclass(frozen=True, kw_only=True)
class Park(Section):
    """What the nodes are set to while no run is performed.

    Attributes
    ----------
    parameters : mapping from str to value
        Values of tuned parameters of the study; the others have their default.
    between_runs : bool
        Whether also between two runs, and while a run is prepared; else in a pause, after a run
        that failed, and at the end.
    """

    parameters: Annotated[Mapping[str, ParameterValue], Expected("values by parameter")] = field(
        default_factory=dict
    )
    between_runs: bool = False
