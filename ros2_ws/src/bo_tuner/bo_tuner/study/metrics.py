"""The metrics of a study, by kind: reported by a node, or computed from signals.

Each class checks its own fields, and raises a `StudyError` with the key path from the object to the
value.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Protocol

from bo_tuner.errors import StudyError
from bo_tuner.numerics.signal_metrics import MEASURES, options_of
from bo_tuner.study import checks
from bo_tuner.study.signals import TIME, expression


class Metric(Protocol):
    """A number that an evaluation has as its result, wherever it comes from."""

    @property
    def name(self) -> str:
        """Name in the study."""

    @property
    def unit(self) -> str:
        """Unit, for display only."""

    @property
    def reproducible(self) -> bool:
        """Whether the same evaluation gives the same number again."""

    @property
    def measures_time(self) -> bool:
        """Whether it is a measured time, which other load on the machine makes longer."""


@dataclass(frozen=True, kw_only=True)
class ReportedMetric:
    """A number that a node reports after an evaluation.

    Attributes
    ----------
    name : str
        Name in the study.
    node : str
        Node of the study.
    key : str
        Key of the number in what the node reports; the metric's name unless given.
    unit : str
        Unit, for display only.
    reproducible : bool
        Whether a repeated evaluation gives the same number. One that depends on measured time
        differs over ROS, and `replay` does not judge it.
    """

    name: str
    node: str
    key: str = ""
    unit: str = ""
    reproducible: bool = True

    def __post_init__(self) -> None:
        checks.parameter_name(self.name)
        checks.text(self.node, "node")
        checks.text(self.unit, "unit")
        checks.boolean(self.reproducible, "reproducible")
        if not checks.text(self.key, "key"):
            object.__setattr__(self, "key", self.name)

    @property
    def measures_time(self) -> bool:
        """Whether it depends on measured time."""
        return not self.reproducible


@dataclass(frozen=True, kw_only=True)
class SignalMetric:
    """A number that is computed from the signals of a run.

    Attributes
    ----------
    name : str
        Name in the study.
    of : str
        A signal, or an expression of several.
    measure : str
        What is computed from it, such as `iae` or `overshoot`; docs/interfaces.md lists all.
    unit : str
        Unit, for display only.
    target : float or str, optional
        Where a step should end: a number, or an expression, whose value at the end counts.
    percent : float, optional
        Percentage of the time in which `percentile` is not exceeded, 0 to 100.
    band : float, optional
        Distance from `target` within which `settling_time` takes the step as settled, as a share of
        the step; 0.02 unless given.
    """

    name: str
    of: str
    measure: str
    unit: str = ""
    target: float | str | None = None
    percent: float | None = None
    band: float | None = None

    reproducible = False
    """Of measured signals no two runs give the same."""

    measures_time = False

    def __post_init__(self) -> None:
        checks.parameter_name(self.name)
        checks.text(self.of, "of")
        checks.text(self.unit, "unit")
        checks.choice(self.measure, tuple(MEASURES), "measure")
        options = options_of(self.measure)
        for key in ("target", "percent", "band"):
            value = getattr(self, key)
            if value is None and options.get(key):
                raise StudyError(f"missing; {self.measure} needs one", (key,))
            if value is not None and key not in options:
                raise StudyError(f"{self.measure} has none", (key,))
            if value is not None and not (key == "target" and isinstance(value, str)):
                object.__setattr__(self, key, checks.magnitude(value, key))
        if self.percent is not None and not 0.0 <= self.percent <= 100.0:
            raise StudyError(f"expected 0 to 100, found {self.percent:g}", ("percent",))
        if self.band is not None:
            checks.positive(self.band, "band")

    def check_signals(self, signals: Iterable[str]) -> None:
        """Refuse expressions with signals that the study does not have."""
        found = expression(self.of, signals, "of").names
        if not found - {TIME}:
            raise StudyError("expected an expression with a signal", ("of",))
        if self.measure == "largest_rate" and len(found) > 1:
            raise StudyError(
                "the largest_rate of several signals depends on when their messages come; "
                "expected one signal",
                ("of",),
            )
        if isinstance(self.target, str):
            expression(self.target, signals, "target")


@dataclass(frozen=True, kw_only=True)
class PythonMetric:
    """A number that a function of the user computes from the signals of a run.

    Attributes
    ----------
    name : str
        Name in the study.
    python : str
        `module:function`, in a module that can be imported.
    unit : str
        Unit, for display only.
    """

    name: str
    python: str
    unit: str = ""

    reproducible = False
    """Of measured signals no two runs give the same."""

    measures_time = False

    def __post_init__(self) -> None:
        checks.parameter_name(self.name)
        checks.matching(
            self.python, checks.OBJECT_PATH, "module:function such as my_metrics:jerk", "python"
        )
        checks.text(self.unit, "unit")


StudyMetric = ReportedMetric | SignalMetric | PythonMetric


def metric_kind(fields: object) -> type[StudyMetric]:
    """Return the kind of metric that the keys of an entry of `metrics` in a study file mean."""
    keys = fields.keys() if isinstance(fields, dict) else ()
    if "of" in keys or "measure" in keys:
        return SignalMetric
    return PythonMetric if "python" in keys else ReportedMetric
