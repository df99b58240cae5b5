"""The metrics of a study, by kind: reported by a node, computed from signals, or from others.

Each class checks its own fields, and raises a `StudyError` with the key path from the object to the
value.
"""

import dataclasses
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Annotated, ClassVar, Protocol

import numpy as np

from bo_tuner.codec import checks
from bo_tuner.codec.rules import POSITIVE, SECONDS, Chosen, Matching
from bo_tuner.errors import StudyError
from bo_tuner.numerics.expressions import Expression
from bo_tuner.study.distance_metric import DistanceMetric
from bo_tuner.study.lag_metric import LagMetric
from bo_tuner.study.measures import check_measure
from bo_tuner.study.metric_keys import MetricKeys, ScaledMetricKeys
from bo_tuner.study.parts import LINEAR
from bo_tuner.study.path_metric import PathMetric
from bo_tuner.study.signals import TIME, Signal, expression, named_expression, only_numbers
from bo_tuner.study.trajectory_metric import TrajectoryMetric


class Metric(Protocol):
    """A number that an evaluation has as its result, wherever it comes from."""

    @property
    def name(self) -> str:
        """Name in the study."""

    @property
    def title(self) -> str:
        """What screens call it."""

    @property
    def unit(self) -> str:
        """Unit, for display only."""

    @property
    def range(self) -> tuple[float, float] | None:
        """Smallest and largest value that any run can have; None if not known."""

    @property
    def scale(self) -> str:
        """The scale on which it is modelled if it is limited."""

    @property
    def reproducible(self) -> bool:
        """Whether the same evaluation gives the same number again."""

    @property
    def measures_time(self) -> bool:
        """Whether it is a measured time, which other load on the machine makes longer."""


@dataclass(frozen=True, kw_only=True)
class ReportedMetric(ScaledMetricKeys):
    """A number that a node reports after an evaluation.

    Attributes
    ----------
    node : str
        Node of the study.
    key : str
        Key of the number in what the node reports; the metric's name unless given.
    reproducible : bool
        Whether a repeated evaluation gives the same number. One that depends on measured time
        differs over ROS, and `replay` does not judge it.
    grows : bool
        Whether it only grows during a run, as a maximum so far or a sum of what is never negative,
        and the object can end a run early by it; for `cut_short`.
    """

    node: str
    key: str = ""
    reproducible: bool = True
    grows: bool = False

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.key:
            object.__setattr__(self, "key", self.name)

    @property
    def measures_time(self) -> bool:
        """Whether it depends on measured time."""
        return not self.reproducible


@dataclass(frozen=True, kw_only=True)
class SignalMetric(ScaledMetricKeys):
    """A number that is computed from the signals of a run.

    Attributes
    ----------
    of : str
        A signal, or an expression of several.
    measure : str
        What is computed from it, such as `iae`, `max` or `overshoot`; docs/interfaces.md lists
        all.
    target : float or str, optional
        Where a step should end: a number, or an expression, whose value at the end counts.
    percent : float, optional
        Percentage of the time in which `percentile` is not exceeded, 0 to 100.
    band : float, optional
        Distance from `target` within which `settling_time` takes the step as settled, as a share of
        the step; 0.02 unless given.
    """

    of: str
    measure: str
    target: float | str | None = None
    percent: float | None = None
    band: float | None = None

    reproducible = False
    """Of measured signals no two runs give the same."""

    measures_time = False

    def __post_init__(self) -> None:
        super().__post_init__()
        check_measure(self)

    def check_signals(self, signals: Iterable[str]) -> None:
        """Refuse expressions with signals that the study does not have."""
        names = expression(self.of, signals, "of").names
        if not names - {TIME}:
            raise StudyError("expected an expression with a signal", ("of",))
        if self.measure == "largest_rate" and len(names) > 1:
            raise StudyError(
                "the largest_rate of several signals depends on when their messages come; "
                "expected one signal",
                ("of",),
            )
        if isinstance(self.target, str):
            expression(self.target, signals, "target")

    def check_kinds(self, signals: Mapping[str, Signal]) -> None:
        """Refuse expressions with signals that are no numbers."""
        only_numbers(self.of, signals, "of")
        if isinstance(self.target, str):
            only_numbers(self.target, signals, "target")

    @property
    def expressions(self) -> list[str]:
        """The expressions of signals that it needs."""
        return [text for text in (self.of, self.target) if isinstance(text, str)]


@dataclass(frozen=True, kw_only=True)
class PythonMetric(ScaledMetricKeys):
    """A number that a function of the user computes from the signals of a run.

    It runs in a process of its own, which an interruption ends at once.

    Attributes
    ----------
    python : str
        `module:function`, in a module beside the study file, or one that Python finds anyway.
    timeout : float, optional
        Longest time [s] that the function may take; an evaluation in which it takes longer fails.
    """

    python: Annotated[str, Matching(checks.OBJECT_PATH, "module:function such as my_metrics:jerk")]
    timeout: Annotated[float, SECONDS] | None = None

    reproducible = False
    """Of measured signals no two runs give the same."""

    measures_time = False


@dataclass(frozen=True, kw_only=True)
class CombinedMetric(ScaledMetricKeys):
    """A number that is computed from other metrics of the same evaluation.

    Attributes
    ----------
    expression : str
        Of the names of other metrics, as `error + 0.01 * effort`. Each counts as the number that
        it is in its own unit; a weight is one unit for another.
    unit : str
        Unit, for display only. Unless given, that of the metrics, if all have the same and the
        expression keeps it, as a sum does.
    """

    expression: str

    _of: ClassVar[Expression]
    parts: ClassVar[
        tuple[
            ReportedMetric
            | SignalMetric
            | PathMetric
            | TrajectoryMetric
            | LagMetric
            | PythonMetric,
            ...,
        ]
    ] = ()
    """The metrics that it is computed from; there as soon as it is `joined` to a study."""

    def joined(self, metrics: "Mapping[str, StudyMetric]") -> "CombinedMetric":
        """Return it with references to the metrics of a study that it is computed from.

        Raises
        ------
        StudyError
            If it is no expression of metrics that are measured.
        """
        measured = {k: m for k, m in metrics.items() if not isinstance(m, COMPUTED)}
        of = metric_expression(self.expression, measured, "expression")
        parts = {name: measured[name] for name in sorted(of.names)}
        joined = dataclasses.replace(self, unit=self.unit or _common_unit(of, parts))
        # Not fields of the class, which would be keys of a study file.
        object.__setattr__(joined, "_of", of)
        object.__setattr__(joined, "parts", tuple(parts.values()))
        return joined

    def value(self, metrics: Mapping[str, float]) -> float:
        """Return its value for the values of its parts; NaN or infinite where it is undefined."""
        return float(self._of({name: metrics[name] for name in self._of.names}))

    @property
    def reproducible(self) -> bool:
        """Whether the same evaluation gives the same number again: if it does for all parts."""
        return all(part.reproducible for part in self.parts)

    @property
    def measures_time(self) -> bool:
        """Whether it depends on a measured time."""
        return any(part.measures_time for part in self.parts)


@dataclass(frozen=True, kw_only=True)
class RelativeMetric(MetricKeys):
    """A metric minus a multiple of its value for the default in the same draw.

    The default is run ahead of each evaluation, in the same context and with the same seed. A limit
    such as `upper: 1.1 * default` is one on such a metric.

    Attributes
    ----------
    relative : str
        The other metric.
    factor : float
        Multiple of the default's value that is subtracted; above 0.
    unit : str
        Unit, for display only; that of the other metric unless given.
    """

    relative: str
    factor: Annotated[float, checks.magnitude, POSITIVE] = 1.0

    scale = LINEAR
    """A difference can be negative, and so has no logarithm."""

    parts: "ClassVar[tuple[StudyMetric, ...]]" = ()
    """The other metric; there as soon as it is `joined` to a study."""

    def joined(self, metrics: "Mapping[str, StudyMetric]") -> "RelativeMetric":
        """Return it with a reference to the other metric, among those of a study.

        Raises
        ------
        StudyError
            If there is no such metric, or it is relative itself.
        """
        checks.reference(self.relative, "metric", metrics, "relative")
        part = metrics[self.relative]
        if isinstance(part, RelativeMetric):
            raise StudyError(f"metric '{part.name}' is relative itself", ("relative",))
        declared = self.range
        if declared is None and part.range is not None:
            low, high = part.range
            declared = low - self.factor * high, high - self.factor * low
        joined = dataclasses.replace(self, unit=self.unit or part.unit, range=declared)
        object.__setattr__(joined, "parts", (part,))
        return joined

    def value(self, metrics: Mapping[str, float], default: Mapping[str, float]) -> float:
        """Return its value from the metrics of an evaluation and of the default's beside it."""
        return metrics[self.relative] - self.factor * default[self.relative]

    @property
    def reproducible(self) -> bool:
        """Whether the same evaluation gives the same number again: if the other metric does."""
        return all(part.reproducible for part in self.parts)

    @property
    def measures_time(self) -> bool:
        """Whether it depends on a measured time."""
        return any(part.measures_time for part in self.parts)


COMPUTED = (CombinedMetric, RelativeMetric)
"""Kinds of metrics that are computed from others."""


def metric_expression(text: object, metrics: Iterable[str], *path: str | int) -> Expression:
    """Return the expression of metrics that a text is.

    Raises
    ------
    StudyError
        If it is none, has other names than those of `metrics`, or no name.
    """
    parsed = named_expression(text, tuple(metrics), "metric", *path)
    if not parsed.names:
        raise StudyError("expected an expression with a metric", path)
    return parsed


def _common_unit(of: Expression, parts: Mapping[str, Metric]) -> str:
    """Return the unit of an expression if it is the common unit of its metrics; empty if not.

    This is so if the value scales with the metrics, f(s x) = s f(x), whatever their values.
    """
    units = {part.unit for part in parts.values()}
    values = {name: np.array([3.0, -2.0, 0.7]) * (k + 1.1) for k, name in enumerate(parts)}
    scales = (1e-3, 1e3)
    keeps = all(
        np.allclose(of({k: s * v for k, v in values.items()}), s * of(values), 1e-9, 0.0, True)
        for s in scales
    )
    return units.pop() if len(units) == 1 and keeps else ""


StudyMetric = (
    ReportedMetric
    | SignalMetric
    | PathMetric
    | TrajectoryMetric
    | LagMetric
    | PythonMetric
    | CombinedMetric
    | RelativeMetric
)


def signals_of(metric: object, signals: Iterable[str]) -> Iterator[str]:
    """Yield the names of the signals that a metric is computed from, of those of a study."""
    if isinstance(metric, PythonMetric):
        yield from signals
    elif isinstance(metric, DistanceMetric | LagMetric):
        yield from metric.signals
    elif isinstance(metric, SignalMetric):
        for text in metric.expressions:
            yield from expression(text, signals).names - {TIME}


def metric_kind(fields: object) -> type[StudyMetric]:
    """Return the kind of metric that the keys of an entry of `metrics` in a study file mean."""
    keys = fields.keys() if isinstance(fields, dict) else ()
    if "plan" in keys or "path" in keys:
        return PathMetric
    if "truth" in keys or "estimate" in keys:
        return TrajectoryMetric
    if "lag" in keys or "behind" in keys:
        return LagMetric
    if "of" in keys or "measure" in keys:
        return SignalMetric
    if "expression" in keys:
        return CombinedMetric
    if "relative" in keys:
        return RelativeMetric
    return PythonMetric if "python" in keys else ReportedMetric


MetricOfStudy = Annotated[StudyMetric, Chosen(metric_kind)]
"""A metric of the kind that its keys mean."""
