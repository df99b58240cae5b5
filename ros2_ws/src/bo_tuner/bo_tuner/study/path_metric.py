"""How far a path leads from a plan, as a metric of a study."""

from collections.abc import Collection, Mapping
from dataclasses import dataclass

from bo_tuner.codec import checks
from bo_tuner.errors import StudyError
from bo_tuner.numerics.signal_metrics import MEASURES, SYNONYMS, options_of
from bo_tuner.study.measures import check_measure
from bo_tuner.study.metric_scale import check_scale
from bo_tuner.study.parts import LINEAR
from bo_tuner.study.ranges import check_range
from bo_tuner.study.signals import Signal
from bo_tuner.study.titles import Titled, check_label

PLAN_TYPE = "nav_msgs/msg/Path"
"""Type of the messages that a plan may have."""


@dataclass(frozen=True, kw_only=True)
class PathMetric(Titled):
    """A number that is computed from the distance of a path from the plan that holds at the time.

    The distance is that from the nearest point of the line through the plan's poses. At each
    message of the path or of a plan, the latest message of each by its stamp counts.

    Attributes
    ----------
    name : str
        Name in the study.
    path : list of str
        The signals that are the coordinates of the path, x and y or x, y and z [m], in the frame
        of the plan.
    plan : str
        A signal of whole messages, of the type `nav_msgs/msg/Path`.
    measure : str
        What is computed from the distance, such as `maximum`, `rms` or `percentile`.
    label : str
        What screens call it in place of its name, such as ``solve time (p99)``.
    unit : str
        Unit, for display only.
    percent : float, optional
        Percentage of the time in which `percentile` is not exceeded, 0 to 100.
    scale : str
        How it is modelled if it is limited: `linear` as it is, or `log` for a positive metric that
        varies in proportion.
    range : tuple of float, optional
        The smallest and the largest value, in `unit`, that any run can have. A certificate shows a
        limit on a mean by it, whatever the noise is.
    """

    name: str
    path: tuple[str, ...]
    plan: str
    measure: str
    label: str = ""
    unit: str = "m"
    scale: str = LINEAR
    percent: float | None = None
    range: tuple[float, float] | None = None

    reproducible = False
    """Of measured signals no two runs give the same."""

    measures_time = False

    def __post_init__(self) -> None:
        checks.parameter_name(self.name)
        check_range(self)
        expected = "two or three signals, as [x, y]"
        names = checks.sequence(self.path, expected, "path")
        if len(names) not in (2, 3):
            raise StudyError(f"expected {expected}, found {checks.show(names)}", ("path",))
        path = tuple(checks.text(name, "path", index) for index, name in enumerate(names))
        object.__setattr__(self, "path", path)
        checks.text(self.plan, "plan")
        check_label(self.label)
        checks.text(self.unit, "unit")
        check_scale(self)
        of_distance = [name for name in MEASURES if not options_of(name).get("target")]
        known = [*of_distance, *(s for s, name in SYNONYMS.items() if name in of_distance)]
        checks.choice(self.measure, known, "measure")
        check_measure(self)

    @property
    def signals(self) -> tuple[str, ...]:
        """Names of all signals that it needs."""
        return (*self.path, self.plan)

    def check_signals(self, signals: Collection[str]) -> None:
        """Refuse signals that the study does not have."""
        for index, name in enumerate(self.path):
            checks.reference(name, "signal", signals, "path", index)
        checks.reference(self.plan, "signal", signals, "plan")

    def check_kinds(self, signals: Mapping[str, Signal]) -> None:
        """Refuse coordinates that are no numbers, and a plan that is one."""
        for index, name in enumerate(self.path):
            if not signals[name].is_number:
                raise StudyError(f"signal {name} has no field; expected a number", ("path", index))
        plan = signals[self.plan]
        if plan.is_number or plan.type not in ("", PLAN_TYPE):
            raise StudyError(
                f"expected a signal of whole messages {PLAN_TYPE}, found {self.plan}, "
                + (f"the field {plan.field}" if plan.is_number else f"of type {plan.type}"),
                ("plan",),
            )
        for index, name in enumerate(self.path):
            frames = signals[name].frames
            if frames is not None and frames[0] != (signals[self.path[0]].frames or frames)[0]:
                raise StudyError(
                    f"is in the frame {frames[0]}, and {self.path[0]} is not", ("path", index)
                )
