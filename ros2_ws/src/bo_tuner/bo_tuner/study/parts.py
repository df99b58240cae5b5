"""The parts of a study. Each class checks its own fields.

A violated rule raises a `StudyError` with the key path from the object to the value.
"""

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike

from bo_tuner.codec import checks
from bo_tuner.codec.reading import Section
from bo_tuner.codec.rules import KEY, SECONDS, Beside, Matching, OneOf
from bo_tuner.errors import StudyError
from bo_tuner.numerics.arrays import Array
from bo_tuner.study.distributions import DISTRIBUTIONS, Discrete, Distribution
from bo_tuner.study.parameter import TYPES

ROS, IN_PROCESS = "ros", "inprocess"
BACKENDS = (ROS, IN_PROCESS)
"""Names of the backends, on the command line and on record: ROS nodes, the default, or objects in
this process."""

DOUBLE, INTEGER = "double", "integer"

TINY = float(np.finfo(np.float64).tiny)

LINEAR, LOG = "linear", "log"
RANDOM, NONE = "random", "none"
MINIMIZE, MAXIMIZE = "minimize", "maximize"


@dataclass(frozen=True, kw_only=True)
class ContextVariable(Section):
    """What varies from evaluation to evaluation: a parameter of a node, or a value in braces.

    Attributes
    ----------
    name : str
        Name in the study.
    node : str
        Node of the study that has the parameter. A variable without one stands in the steps of
        `run`, or in what starts a node, by its name in braces: `goal: {x: "{goal_x}"}`.
    distribution : Distribution
        Distribution of its values in operation.
    type : str
        `double`, `integer`, `boolean` or `string`. Unless given, what the values of the
        distribution are, and double for numbers; an integer takes the nearest integer of any
        distribution.
    unit : str
        Unit, for display only.
    parameter : str
        Name of the parameter in the node; the name of this entry unless given.
    """

    name: Annotated[str, KEY, checks.parameter_name]
    node: str = ""
    distribution: Annotated[Distribution, Beside(lambda: DISTRIBUTIONS)]
    type: Annotated[str, OneOf(TYPES)] = ""
    unit: str = ""
    parameter: Annotated[str, checks.name_in_node] = ""

    def __post_init__(self) -> None:
        super().__post_init__()
        self._check_type()
        if not self.node:
            if self.parameter:
                raise StudyError("without a node there is no parameter; add node", ("parameter",))
            return
        if self.parameter == "":
            object.__setattr__(self, "parameter", self.name)

    def _check_type(self) -> None:
        """Find the type, or refuse one that the distribution's values do not have."""
        labels = self.distribution.labels
        type_of_values = DOUBLE
        if labels:
            type_of_values = "boolean" if isinstance(labels[0], bool) else "string"
        if self.type == "":
            object.__setattr__(self, "type", type_of_values)
        if self.type == INTEGER and type_of_values == DOUBLE:
            item = self.distribution
            numbers = item.support if isinstance(item, Discrete) else [item.lower, item.upper]
            for number in numbers:
                if number != round(number):
                    raise StudyError(
                        "expected integers as the values or bounds of an integer, found "
                        f"{number:g}",
                        ("type",),
                    )
        elif self.type != type_of_values:
            raise StudyError(
                f"expected {type_of_values}, as its values are, found {self.type}; numbers are of "
                f"{DOUBLE} or {INTEGER}, truth values and texts of discrete",
                ("type",),
            )


@dataclass(frozen=True, kw_only=True)
class SeedParameter(Section):
    """The parameter that seeds the noise of an evaluation.

    Attributes
    ----------
    node : str
        Node of the study.
    parameter : str
        Its integer parameter.
    """

    node: str
    parameter: Annotated[str, checks.name_in_node]


@dataclass(frozen=True, kw_only=True)
class Trigger(Section):
    """The service that starts a run.

    Attributes
    ----------
    node : str
        Node of the study.
    service : str
        Its service, of type std_srvs/srv/Trigger; `~/` stands for the node's own name.
    timeout : float
        Longest time [s] of a run, from the call to the result.
    """

    node: str
    service: Annotated[str, Matching(checks.TOPIC_NAME, "a service name such as ~/run_cut")]
    timeout: Annotated[float, SECONDS] = 30.0


@dataclass(frozen=True, kw_only=True)
class Objective(Section):
    """The metric whose expectation over the contexts is optimized.

    Attributes
    ----------
    metric : str
        Metric in the study.
    scale : str
        `linear`, or `log` for a positive metric that spans orders of magnitude.
    direction : str
        `minimize` or `maximize`.
    """

    metric: str
    scale: Annotated[str, OneOf((LINEAR, LOG))] = LINEAR
    direction: Annotated[str, OneOf((MINIMIZE, MAXIMIZE))] = MINIMIZE

    @property
    def sign(self) -> float:
        """Factor that turns the metric into a cost: 1 to minimize, -1 to maximize."""
        return 1.0 if self.direction == MINIMIZE else -1.0

    def to_cost(self, values: ArrayLike) -> Array:
        """Return costs, smaller is better, for metric values, both of shape (...).

        On the log scale a value that is not positive gives NaN.
        """
        cost = np.asarray(values, dtype=np.float64)
        if self.scale == LOG:
            cost = np.log(np.where(cost > 0.0, cost, np.nan))
        return self.sign * cost

    def from_cost(self, cost: ArrayLike) -> Array:
        """Return metric values for costs, both of shape (...); the inverse of `to_cost`."""
        values = self.sign * np.asarray(cost, dtype=np.float64)
        return np.exp(values) if self.scale == LOG else values

    def relative_loss(
        self, cost: ArrayLike, reference: ArrayLike, size_of_zero: float = TINY
    ) -> Array:
        """Return how much worse a value of the metric is than another one, relative to the other.

        Parameters
        ----------
        cost, reference : array-like, shape (...)
            Costs of the two values, as `to_cost` returns them.
        size_of_zero : float
            Size that the loss is relative to where the other is 0.

        Returns
        -------
        ndarray, shape (...)
            0.1 if the metric is a tenth larger, or smaller if it is maximized; negative if it is
            better.
        """
        cost, reference = np.asarray(cost, np.float64), np.asarray(reference, np.float64)
        if self.scale == LOG:
            return np.asarray(self.sign * np.expm1(self.sign * (cost - reference)))
        return np.asarray((cost - reference) / _size(reference, size_of_zero))

    def worsened(self, cost: ArrayLike, loss: ArrayLike, size_of_zero: float = TINY) -> Array:
        """Return the cost (...) of a metric that is worse than `cost` by the relative `loss`.

        A maximized metric on the log scale loses less than all of its value.
        """
        cost, loss = np.asarray(cost, np.float64), np.asarray(loss, np.float64)
        if self.scale == LOG:
            return np.asarray(cost + self.sign * np.log1p(self.sign * loss))
        return np.asarray(cost + _size(cost, size_of_zero) * loss)


def _size(cost: Array, of_zero: float) -> Array:
    """Return the size of a cost (...) that a loss is relative to."""
    return np.where(cost == 0.0, of_zero, np.abs(cost))
