"""The parts of a study. Each class checks its own fields.

A violated rule raises a `StudyError` with the key path from the object to the value.
"""

import dataclasses
import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import ndtri

from bo_tuner.errors import StudyError
from bo_tuner.numerics.arrays import Array
from bo_tuner.study import checks, maxima
from bo_tuner.study.distributions import Distribution

ROS, IN_PROCESS = "ros", "inprocess"
BACKENDS = (ROS, IN_PROCESS)
"""Names of the backends, on the command line and on record: ROS nodes, the default, or objects in
this process."""

LINEAR, LOG = "linear", "log"
MINIMIZE, MAXIMIZE = "minimize", "maximize"
CHANCE, WORST_CASE = "chance", "worst_case"


@dataclass(frozen=True, kw_only=True)
class ContextVariable:
    """A double parameter that varies from evaluation to evaluation.

    Attributes
    ----------
    name : str
        Name in the study.
    node : str
        Node of the study that has the parameter.
    distribution : Distribution
        Distribution of its values in operation.
    unit : str
        Unit, for display only.
    parameter : str
        Name of the parameter in the node; `name` unless given.
    """

    name: str
    node: str
    distribution: Distribution
    unit: str = ""
    parameter: str = ""

    def __post_init__(self) -> None:
        checks.parameter_name(self.name)
        checks.text(self.node, "node")
        checks.text(self.unit, "unit")
        if self.parameter == "":
            object.__setattr__(self, "parameter", self.name)
        checks.parameter_name(self.parameter, "parameter")


@dataclass(frozen=True, kw_only=True)
class SeedParameter:
    """The parameter that seeds the noise of an evaluation.

    Attributes
    ----------
    node : str
        Node of the study.
    parameter : str
        Its integer parameter.
    """

    node: str
    parameter: str

    def __post_init__(self) -> None:
        checks.text(self.node, "node")
        checks.parameter_name(self.parameter, "parameter")


@dataclass(frozen=True, kw_only=True)
class Trigger:
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
    service: str
    timeout: float = 30.0

    def __post_init__(self) -> None:
        checks.text(self.node, "node")
        checks.matching(
            self.service, checks.TOPIC_NAME, "a service name such as ~/run_cut", "service"
        )
        object.__setattr__(self, "timeout", checks.timeout(self.timeout, "timeout"))


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
class Objective:
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
    scale: str = LINEAR
    direction: str = MINIMIZE

    def __post_init__(self) -> None:
        checks.text(self.metric, "metric")
        checks.choice(self.scale, (LINEAR, LOG), "scale")
        checks.choice(self.direction, (MINIMIZE, MAXIMIZE), "direction")

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


UPPER, LOWER = "upper", "lower"
EXPECTATION, SINGLE_RUN = "expectation", "single_run"
"""What a limit is on: the mean over noise, or single runs, of which a share must keep it."""


@dataclass(frozen=True, kw_only=True)
class Constraint:
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
        Largest permitted value, in the metric's unit. At least one of `upper` and `lower`.
    lower : float, optional
        Smallest permitted value, in the metric's unit. With both limits, either side may be
        violated half as often as the `probability` permits, so that both hold as often as asked.
    probability : float, optional
        Between 0 and 1. Required for a `chance` constraint. With it, in every context a run keeps
        the limit of a `worst_case` constraint with at least this probability, 0.5 or more; without
        it, in every context the mean over noise keeps the limit (Eq. 3e).
    """

    name: str
    kind: str
    metric: str
    upper: float | None = None
    lower: float | None = None
    probability: float | None = None

    def __post_init__(self) -> None:
        checks.parameter_name(self.name)
        checks.choice(self.kind, (CHANCE, WORST_CASE), "kind")
        checks.text(self.metric, "metric")
        if self.upper is None and self.lower is None:
            raise StudyError("missing; expected upper, lower or both", ("upper",))
        if self.upper is not None:
            object.__setattr__(self, "upper", checks.number(self.upper, "upper"))
        if self.lower is not None:
            object.__setattr__(self, "lower", checks.number(self.lower, "lower"))
            if self.upper is not None and not self.lower < self.upper:
                raise StudyError(
                    f"expected less than upper, {self.upper:g}, found {self.lower:g}", ("lower",)
                )
        if self.probability is None:
            if self.kind == CHANCE:
                raise StudyError(
                    "missing; a chance constraint needs one, such as 0.96", ("probability",)
                )
            return
        probability = checks.fraction(self.probability, "probability")
        if self.kind == WORST_CASE and probability < 0.5:
            raise StudyError(
                f"expected at least 0.5 of a worst_case constraint, found {probability:g}",
                ("probability",),
            )
        object.__setattr__(self, "probability", probability)

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

    @property
    def sign(self) -> float:
        """Factor that turns the metric into one with an upper limit: -1 for a lower limit."""
        return 1.0 if self.lower is None else -1.0

    @property
    def limit(self) -> float:
        """The only limit, in the metric's unit.

        Raises
        ------
        ValueError
            If there are two.
        """
        limits = [limit for limit in (self.lower, self.upper) if limit is not None]
        if len(limits) != 1:
            raise ValueError(f"constraint {self.name} has two limits, see its sides")
        return limits[0]

    @property
    def side(self) -> str:
        """Which limit it has: ``upper`` or ``lower``."""
        return UPPER if self.sign > 0.0 else LOWER

    @property
    def beyond(self) -> str:
        """Where the violating values are: ``above`` or ``below`` the limit."""
        return "above" if self.sign > 0.0 else "below"

    @property
    def extreme(self) -> str:
        """What the value farthest on the side of the limit is: the ``largest`` or ``smallest``."""
        return "largest" if self.sign > 0.0 else "smallest"

    @property
    def limited(self) -> str:
        """The metric that is limited, in words: the ``lowest`` one for a lower limit."""
        return self.metric if self.sign > 0.0 else f"lowest {self.metric}"

    def violations(self, values: ArrayLike) -> NDArray[np.bool_]:
        """Return whether each of the values (...) of its metric violates the limit."""
        found: NDArray[np.bool_] = self.sign * np.asarray(values) > self.sign * self.limit
        return found

    def excess(self, value: float) -> float:
        """Return how far a value of its metric is beyond the limit, relative to the limit's size.

        Negative if it keeps the limit; not relative to a limit of 0.
        """
        return self.sign * (value - self.limit) / (abs(self.limit) or 1.0)

    def farthest(self, values: ArrayLike) -> float:
        """Return the extreme of the values (n,) of its metric, in its unit; NaN of none."""
        found = self.sign * np.asarray(values, dtype=np.float64)
        return self.sign * float(found.max()) if found.size else float("nan")

    @property
    def statistic(self) -> str:
        """What the limit is on: ``expectation`` or ``single_run``."""
        return EXPECTATION if self.probability is None else SINGLE_RUN

    @property
    def level(self) -> float:
        """Probability with which a run must keep the limit; one half for an expectation.

        A run keeps a limit at the mean of symmetric noise just as often.
        """
        return 0.5 if self.probability is None else self.probability

    @property
    def allowed(self) -> float:
        """Largest permitted probability that a run violates the limit.

        Over contexts and noise for a `chance` constraint, in any one context for a `worst_case`
        one; 1 for an expectation, which permits any.
        """
        return 1.0 if self.probability is None else 1.0 - self.probability

    @property
    def deviations(self) -> float:
        """Standard deviations between the mean of a normal metric and a limit kept so often."""
        return float(ndtri(self.level))


MOST = {
    "trials": maxima.TRIALS,
    "initial_trials": maxima.TRIALS,
    "drawn_contexts": maxima.EVALUATIONS,
    "search_evaluations": maxima.EVALUATIONS,
    "validation_draws": maxima.DRAWS,
    "evaluations": maxima.TRIALS * maxima.EVALUATIONS,
}


@dataclass(frozen=True, kw_only=True)
class CertificateRequirement:
    """What a certificate must have for `apply`, at least.

    Attributes
    ----------
    draws : int
        Fresh draws of context and noise, at most, and runs in a context that may be the worst; a
        clear verdict takes fewer. More where a chance constraint takes more to be shown.
    confidence : float
        Confidence of each bound, between 0 and 1.
    """

    draws: int = 1000
    confidence: float = 0.95

    def __post_init__(self) -> None:
        checks.integer(self.draws, "draws", at_least=2)
        object.__setattr__(self, "confidence", checks.fraction(self.confidence, "confidence"))


@dataclass(frozen=True, kw_only=True)
class Budget:
    """Number of trials and evaluations.

    Attributes
    ----------
    trials : int
        Trials, each of one parameter set, including the initial design.
    initial_trials : int
        Trials of the initial design, which are at most all.
    drawn_contexts : int, optional
        Evaluations per trial in contexts drawn from their distribution. Unless given, the
        algorithm's: 5, or 2 for boundary.
    search_evaluations : int, optional
        Largest number of evaluations per trial in the search for the worst context, for all
        worst-case constraints together. Unless given, the algorithm's: 10, or 3 for boundary.
    validation_draws : int
        Fresh draws of context and noise for the validation of the result.
    evaluations : int, optional
        Evaluations of all trials together; the tuning also ends with the trial that reaches it.
    """

    trials: int
    initial_trials: int
    drawn_contexts: int | None = None
    search_evaluations: int | None = None
    validation_draws: int = 25
    evaluations: int | None = None

    def remaining(self, trials: int, evaluations: int) -> int:
        """Return how many more trials the budget suffices for, after so many with so many.

        Where evaluations limit it, further trials are expected to take as many each as the others.
        """
        left = self.trials - trials
        if self.evaluations is not None:
            each = max(evaluations, 1) / max(trials, 1)
            left = min(left, math.ceil((self.evaluations - evaluations) / each))
        return max(left, 0)

    @property
    def warning(self) -> str:
        """Tell in a line that no trial is left after the initial design; empty if some are."""
        if self.initial_trials < self.trials:
            return ""
        return f"the initial design takes all of the {self.trials} trials; none is proposed"

    def is_spent(self, trials: int, evaluations: int) -> bool:
        """Return whether so many trials, with so many evaluations, use up the budget."""
        return self.remaining(trials, evaluations) == 0

    def __post_init__(self) -> None:
        for item in dataclasses.fields(self):
            if item.default is None and getattr(self, item.name) is None:
                continue
            lowest = 0 if item.name == "search_evaluations" else 1
            most = MOST[item.name]
            checks.integer(getattr(self, item.name), item.name, at_least=lowest, at_most=most)
        object.__setattr__(self, "initial_trials", min(self.initial_trials, self.trials))
