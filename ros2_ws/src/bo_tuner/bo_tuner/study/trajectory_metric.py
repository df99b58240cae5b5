"""How far an estimated trajectory is from the true one, as a metric of a study."""

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Annotated

from bo_tuner.codec import checks
from bo_tuner.codec.rules import POSITIVE, Expected
from bo_tuner.errors import StudyError
from bo_tuner.study.distance_metric import Coordinates, DistanceMetric
from bo_tuner.study.signals import Signal

HEADINGS = "two signals, as [true_yaw, yaw]"


@dataclass(frozen=True, kw_only=True)
class TrajectoryMetric(DistanceMetric):
    """A number that is computed from the distance of an estimated position from the true one.

    It is taken at the messages of the estimate; the truth is interpolated between its own.

    Attributes
    ----------
    truth : list of str
        The signals that are the true position, x and y or x, y and z [m].
    estimate : list of str
        Those that are the estimated one.
    align : bool
        Whether the estimate is turned and shifted as a whole, so that it fits best: for odometry,
        whose frame is its own.
    over : float, optional
        Time [s]: the distance is then that between the ways in this time, each seen from where it
        began: the drift. It needs `yaw`.
    yaw : list of str
        The signals that are the true and the estimated heading [rad].
    """

    truth: Coordinates
    estimate: Coordinates
    align: bool = False
    over: Annotated[float, POSITIVE] | None = None
    yaw: Annotated[tuple[str, ...], Expected(HEADINGS)] = ()

    def __post_init__(self) -> None:
        super().__post_init__()
        if len(self.estimate) != len(self.truth):
            raise StudyError(
                f"expected {len(self.truth)} signals, as truth has, found {len(self.estimate)}",
                ("estimate",),
            )
        if self.over is not None:
            if len(self.yaw) != 2:
                found = checks.show(self.yaw)
                raise StudyError(f"expected {HEADINGS}, for over; found {found}", ("yaw",))
            if len(self.truth) != 2:
                raise StudyError("expected x and y alone, for over", ("truth",))
            if self.align:
                raise StudyError("a drift is the same however it is turned", ("align",))
        elif self.yaw:
            raise StudyError("needs over", ("yaw",))

    @property
    def signals(self) -> tuple[str, ...]:
        """Names of all signals that it needs."""
        return (*self.truth, *self.estimate, *self.yaw)

    def check_signals(self, signals: Collection[str]) -> None:
        """Refuse signals that the study does not have."""
        for key in ("truth", "estimate", "yaw"):
            for index, name in enumerate(getattr(self, key)):
                checks.reference(name, "signal", signals, key, index)

    def check_kinds(self, signals: Mapping[str, Signal]) -> None:
        """Refuse signals that are no numbers."""
        for key in ("truth", "estimate", "yaw"):
            for index, name in enumerate(getattr(self, key)):
                if not signals[name].is_number:
                    problem = f"signal {name} has no field; expected a number"
                    raise StudyError(problem, (key, index))
