"""How far a safe search goes, and what it dares."""

from dataclasses import dataclass

from bo_tuner.codec import checks
from bo_tuner.codec.reading import build
from bo_tuner.errors import StudyError

LARGEST_RISK = 0.2
"""With a larger one a search would not be a safe one by any name."""


@dataclass(frozen=True, kw_only=True)
class SafeSearch:
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

    risk: float = 0.005
    travel: float = 0.1

    def __post_init__(self) -> None:
        """Check the fields."""
        risk = checks.fraction(self.risk, "risk")
        if risk > LARGEST_RISK:
            raise StudyError(f"expected at most {LARGEST_RISK:g}, found {risk:g}", ("risk",))
        object.__setattr__(self, "risk", risk)
        object.__setattr__(self, "travel", checks.fraction(self.travel, "travel"))


def build_safe_search(value: object) -> SafeSearch | None:
    """Return what a section of a study file says of a safe search; None if there is to be none.

    Raises
    ------
    StudyError
        If it violates a rule.
    """
    if isinstance(value, bool):
        return SafeSearch() if value else None
    safe_search: SafeSearch = build(SafeSearch, value)
    return safe_search
