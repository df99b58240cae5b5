"""A parameter of a study: tuned, tied to another one, or fixed."""

from dataclasses import dataclass

from bo_tuner.errors import StudyError
from bo_tuner.study import checks

Number = int | float

# Larger integers have no exact double, and the unit cube is computed in doubles.
LARGEST_BOUND = 2**53


@dataclass(frozen=True, kw_only=True)
class Parameter:
    """A ROS parameter of the study; has `bounds`, `tied_to` or `fixed`.

    Attributes
    ----------
    name : str
        Name in the study.
    node : str
        Node of the study that has the parameter.
    type : str
        `integer` or `double`, as ROS calls the type.
    bounds : tuple of two numbers, optional
        Smallest and largest value; makes the parameter a tuned one.
    tied_to : str, optional
        Tuned or fixed parameter whose value this one takes.
    fixed : int or float, optional
        Value in every trial.
    default : int or float, optional
        Hand-tuned value, the baseline of every comparison. Required for a tuned parameter; derived
        for the others, see `SearchSpace.defaults`.
    scale : str
        `linear`, or `log` for a positive parameter whose ratios matter rather than its differences:
        the surrogates then see its logarithm.
    unit : str
        Unit, for display only.
    minimum_correlation : float, optional
        Lower bound of the surrogates' correlation between neighbouring integers.
    parameter : str
        Name of the parameter in the node; `name` unless given.
    """

    name: str
    node: str
    type: str
    bounds: tuple[Number, Number] | None = None
    tied_to: str | None = None
    fixed: Number | None = None
    default: Number | None = None
    scale: str = "linear"
    unit: str = ""
    minimum_correlation: float | None = None
    parameter: str = ""

    def __post_init__(self) -> None:
        """Check the fields; references to other parts of a study are checked there."""
        checks.parameter_name(self.name)
        checks.text(self.node, "node")
        checks.choice(self.type, ("integer", "double"), "type")
        checks.choice(self.scale, ("linear", "log"), "scale")
        checks.text(self.unit, "unit")
        if self.parameter == "":
            object.__setattr__(self, "parameter", self.name)
        checks.parameter_name(self.parameter, "parameter")
        if self.fixed is not None:
            self._check_fixed()
        elif self.tied_to is not None:
            self._check_tied()
        else:
            self._check_tuned()

    @property
    def is_tuned(self) -> bool:
        """Whether the optimizer chooses the value."""
        return self.bounds is not None

    @property
    def is_integer(self) -> bool:
        """Whether the value is an integer."""
        return self.type == "integer"

    def _check_fixed(self) -> None:
        self._refuse("a fixed parameter", "bounds", "tied_to", "minimum_correlation")
        fixed = self._typed(self.fixed, "fixed")
        object.__setattr__(self, "fixed", fixed)
        if self.default is not None and self._typed(self.default, "default") != fixed:
            raise StudyError(
                f"{self.default} differs from the fixed value {fixed}; leave it out", ("default",)
            )
        object.__setattr__(self, "default", fixed)

    def _check_tied(self) -> None:
        self._refuse("a tied parameter", "bounds", "minimum_correlation")
        checks.text(self.tied_to, "tied_to")
        if self.default is not None:
            object.__setattr__(self, "default", self._typed(self.default, "default"))

    def _check_tuned(self) -> None:
        if self.bounds is None:
            raise StudyError(
                "missing; expected [lower, upper] (or tied_to or fixed instead)", ("bounds",)
            )
        items = checks.pair(self.bounds, "bounds [lower, upper]", "bounds")
        lower, upper = (self._typed(item, "bounds", i) for i, item in enumerate(items))
        if self.is_integer and max(abs(lower), abs(upper)) > LARGEST_BOUND:
            raise StudyError("expected bounds of at most 2^53 in size", ("bounds",))
        checks.check_width(lower, upper, "bounds", instead=f"use fixed: {lower}")
        object.__setattr__(self, "bounds", (lower, upper))
        if self.scale == "log" and lower <= 0:
            raise StudyError(
                f"the log scale needs bounds above 0, found lower bound {lower}; "
                f"{_instead_of_log(lower, upper, self.default)}",
                ("scale",),
            )
        if self.default is None:
            raise StudyError("missing; expected the hand-tuned value", ("default",))
        default = self._typed(self.default, "default")
        if not lower <= default <= upper:
            raise StudyError(f"{default} lies outside the bounds [{lower}, {upper}]", ("default",))
        object.__setattr__(self, "default", default)
        if self.minimum_correlation is not None:
            if not self.is_integer:
                raise StudyError("applies to integers only; leave it out", ("minimum_correlation",))
            correlation = checks.fraction(self.minimum_correlation, "minimum_correlation")
            object.__setattr__(self, "minimum_correlation", correlation)

    def _refuse(self, kind: str, *keys: str) -> None:
        if self.scale != "linear":
            raise StudyError(f"{kind} has no scale; leave it out", ("scale",))
        for key in keys:
            if getattr(self, key) is not None:
                raise StudyError(f"{kind} has no {key}; leave it out", (key,))

    def _typed(self, value: object, *path: str | int) -> Number:
        if self.is_integer:
            return checks.integer(value, *path)
        return checks.number(value, *path)


def _instead_of_log(lower: Number, upper: Number, default: object) -> str:
    """Say what to write for bounds that have no logarithm."""
    if lower < 0 or upper <= 0:
        return "leave it out"
    # Three decades below the default, which is where the search is worth while.
    near = default if isinstance(default, (int, float)) and default > 0 else upper
    proposed = 1 if isinstance(lower, int) else float(f"{min(near, upper) / 1000.0:.1g}")
    return f"write bounds: [{proposed}, {upper}], or leave out the scale if 0 itself counts"
