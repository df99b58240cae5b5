"""How far a path leads from a plan, as a metric of a study."""

from collections.abc import Collection, Mapping
from dataclasses import dataclass

from bo_tuner.codec import checks
from bo_tuner.errors import StudyError
from bo_tuner.study.distance_metric import Coordinates, DistanceMetric
from bo_tuner.study.signals import Signal

PLAN_TYPE = "nav_msgs/msg/Path"
"""Type of the messages that a plan may have."""


@dataclass(frozen=True, kw_only=True)
class PathMetric(DistanceMetric):
    """A number that is computed from the distance of a path from the plan that holds at the time.

    The distance is that from the nearest point of the line through the plan's poses. At each
    message of the path or of a plan, the latest message of each by its stamp counts.

    Attributes
    ----------
    path : list of str
        The signals that are the coordinates of the path, x and y or x, y and z [m], in the frame
        of the plan.
    plan : str
        A signal of whole messages, of the type `nav_msgs/msg/Path`.
    """

    path: Coordinates
    plan: str

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
