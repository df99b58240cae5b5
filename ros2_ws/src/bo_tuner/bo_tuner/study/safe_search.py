"""How far a safe search goes, and what it dares."""

from dataclasses import dataclass
from typing import Annotated

from bo_tuner.codec.reading import Section
from bo_tuner.codec.rules import FRACTION, Alone, Within

LARGEST_RISK = 0.2
"""With a larger one a search would not be a safe one by any name."""


@dataclass(frozen=True, kw_only=True)
class SafeSearch(Section):
    """The search tries only parameter sets that it expects to be safe, in bounded steps.

    ``safe_search: true`` alone takes the defaults.

    Attributes
    ----------
    risk : float
        Largest probability with which a run of a parameter set may break a limit, by a pessimistic
        prediction in the most doubtful context; above 0, at most 0.2.
    travel : float
        Largest distance of a tuned number from a parameter set that was tried and has kept its
        limits, as a share of its range on its scale. A parameter may have a `travel` of its own.
    """

    risk: Annotated[float, Within(above=0.0, most=LARGEST_RISK)] = 0.005
    travel: Annotated[float, FRACTION] = 0.1

    alone = Alone(bool, lambda on: {} if on else None, "true, false, or a mapping of the search")
