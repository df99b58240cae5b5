"""A limit on a metric: what it is on, on which side, and how often it must be kept."""

import dataclasses
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated

from scipy.special import ndtri

from bo_tuner.codec.rules import OneOf
from bo_tuner.errors import StudyError
from bo_tuner.study.limit_kinds.base import LimitKind
from bo_tuner.study.limit_kinds.limited import Limited
from bo_tuner.study.limit_kinds.registry import KINDS

MODEL_NAMES = OBJECTIVE, OUTLIERS, FAILURES = "objective", "outliers", "failures"
"""Names of the models that are of no constraint; that of a constraint has the constraint's name."""


@dataclass(frozen=True, kw_only=True)
class Constraint(Limited):
    """An upper or a lower limit on a metric, or both.

    One with both becomes two constraints, ``NAME_lower`` and ``NAME_upper``, in every output.

    Attributes
    ----------
    name : str
        Name in the study.
    kind : str
        `chance`: over contexts and noise, a run keeps the limit with at least `probability`
        (Eq. 3d); `worst_case`: the limit is kept in every context, the worst one included.
    metric : str
        Metric in the study.
    upper : float, optional
        Largest permitted value, in the metric's unit, or relative to what the default has in the
        same context with the same seed, as `1.1 * default`. At least one of `upper` and `lower`.
    lower : float, optional
        Smallest permitted value, in the same two forms. With both limits, either side may be
        violated half as often as the `probability` permits, so that both hold as often as asked.
    probability : float, optional
        Between 0 and 1. Required for a `chance` constraint. With it, in every context a run keeps
        the limit of a `worst_case` constraint with at least this probability, 0.5 or more; without
        it, in every context the mean over noise keeps the limit (Eq. 3e).
    """

    kind: Annotated[str, OneOf(KINDS)]

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.upper is None and self.lower is None:
            raise StudyError("missing; expected upper, lower or both", ("upper",))
        if self.lower is not None and self.upper is not None and not self.lower < self.upper:
            raise StudyError(
                f"expected less than upper, {self.upper:g}, found {self.lower:g}", ("lower",)
            )
        self.rule.check()

    def sides(self) -> tuple["Constraint", ...]:
        """Return constraints of one limit each that together imply this one.

        With both limits, either side gets half of the permitted violations: the probability of
        their union is at most the sum (Boole's inequality).
        """
        if self.lower is None or self.upper is None:
            return (self,)
        half = None if self.probability is None else 0.5 * (1.0 + self.probability)
        lower, upper = f"{self.name}_lower", f"{self.name}_upper"
        return (
            dataclasses.replace(self, name=lower, upper=None, probability=half),
            dataclasses.replace(self, name=upper, lower=None, probability=half),
        )

    @cached_property
    def rule(self) -> LimitKind:
        """The limit by its kind, which says how it is modelled, judged and shown."""
        return KINDS[self.kind](self)

    @property
    def level(self) -> float:
        """Probability with which a run must keep the limit; one half for a limit on the mean."""
        return self.rule.level

    @property
    def allowed(self) -> float:
        """Largest permitted probability of a violation by a run; 1 for a limit on the mean."""
        return self.rule.allowed

    @property
    def deviations(self) -> float:
        """Standard deviations from the mean of a normal metric to a limit kept with the `level`."""
        return float(ndtri(self.level))
