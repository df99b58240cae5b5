"""Parts of an experiment: rows of a table, parametrizations to judge, and further figures."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from bo_tuner.errors import StudyError
from bo_tuner.optimizers.algorithms import ALGORITHMS
from bo_tuner.study import checks
from bo_tuner.study.study import Study
from bo_tuner.trials import Value
from bo_tuner.worst_case.search import OBSERVED, POSTERIOR

RANDOM, WORST_CASE = "random", "worst_case"

PUBLISHED = ("runs", "feasible", "objective", "difference", "best")
"""What the paper's tables say of a row, and from how many runs."""


@dataclass(frozen=True, kw_only=True)
class Row:
    """A row of a table: an algorithm of the product, or another optimizer.

    Attributes
    ----------
    name
        As the tables call it.
    algorithm
        Key of `ALGORITHMS`; or
    optimizer
        an optimizer, as ``module:Class``.
    protocol
        How a trial is evaluated. ``worst_case``: as those of Algorithm IV, with the product's
        search of the worst context. ``random``: by `contexts` cuts in drawn
        contexts; the largest metric seen is the constraint.
    contexts
        Cuts of a trial under ``random``.
    cuts
        Budget, if not the case's.
    worst_case, neighbour_starts
        Choices of stage two, if not the algorithm's.
    published
        What the paper's table says of this row: `PUBLISHED`.
    """

    name: str
    algorithm: str = ""
    optimizer: str = ""
    protocol: str = WORST_CASE
    contexts: int = 0
    evaluations: int | None = None
    worst_case: str = ""
    neighbour_starts: int | None = None
    published: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Check the fields."""
        if bool(self.algorithm) == bool(self.optimizer):
            raise StudyError("expected either an algorithm or an optimizer")
        if self.algorithm:
            checks.choice(self.algorithm, tuple(ALGORITHMS), "algorithm")
        if self.optimizer:
            checks.matching(self.optimizer, checks.OBJECT_PATH, "module:Class", "optimizer")
        checks.choice(self.protocol, (RANDOM, WORST_CASE), "protocol")
        if self.protocol == RANDOM:
            checks.integer(self.contexts, "contexts", at_least=1)
        elif self.contexts:
            raise StudyError("expected with protocol random only", ("contexts",))
        if self.evaluations is not None:
            checks.integer(self.evaluations, "evaluations", at_least=1)
        if self.worst_case:
            checks.choice(self.worst_case, (OBSERVED, POSTERIOR), "worst_case")
        if self.neighbour_starts is not None:
            checks.integer(self.neighbour_starts, "neighbour_starts", at_least=0)
        _check_published(self.published)


@dataclass(frozen=True, kw_only=True)
class Point:
    """A parametrization to judge.

    Attributes
    ----------
    parameters
        The tuned ones.
    neighbours
        Whether its neighbours are listed too; its verdict needs them in any case.
    published
        What the paper's table says of it: `PUBLISHED`.
    """

    parameters: Mapping[str, Value]
    neighbours: bool = False
    published: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Check the fields."""
        if not isinstance(self.neighbours, bool):
            raise StudyError("expected true or false", ("neighbours",))
        _check_published(self.published)


@dataclass(frozen=True, kw_only=True)
class SurrogateFigure:
    """Which run's final surrogates are shown, and how fine the fields are.

    Attributes
    ----------
    row, seed
        The run.
    points
        Values of each real parameter on the grid; an integer has all of its own.
    """

    row: str
    seed: int = 1
    points: int = 25

    def __post_init__(self) -> None:
        """Check the fields."""
        checks.integer(self.seed, "seed", at_least=1)
        checks.integer(self.points, "points", at_least=2)


@dataclass(frozen=True, kw_only=True)
class Calibration:
    """A metric that is modelled in the campaign, beside what is measured.

    Attributes
    ----------
    study
        The study whose nodes are cut.
    metric, key
        The metric, and what its node calls the figure to compare if not the metric itself: a
        median says more of a clock on a shared computer than a quantile far up does.
    node, parameter
        What decides where the metric comes from.
    modelled, measured
        Its two values.
    grid
        Values of some tuned parameters, of which all permitted combinations are cut.
    repeats
        Measured cuts of each.
    """

    study: Study
    metric: str
    key: str = ""
    node: str
    parameter: str
    modelled: str
    measured: str
    grid: Mapping[str, tuple[Value, ...]]
    repeats: int = 5

    def __post_init__(self) -> None:
        """Check the fields."""
        checks.reference(self.metric, "metric", self.study.metrics, "metric")
        checks.text(self.key, "key")
        checks.reference(self.node, "node", self.study.nodes, "node")
        checks.parameter_name(self.parameter, "parameter")
        checks.integer(self.repeats, "repeats", at_least=1)
        for name in self.grid:
            checks.reference(name, "parameter", self.study.parameters, "grid", name)


@dataclass(frozen=True, kw_only=True)
class Cost:
    """How the cost of a run grows, on a study in closed form whose cuts cost nothing.

    Attributes
    ----------
    algorithm
        Key of `ALGORITHMS`.
    dimensions, trials
        Number of tuned parameters, and trials at which the cost is taken.
    compared_trials
        Trials at which different numbers of parameters are compared.
    seeds
        Runs of each.
    """

    algorithm: str = "IV"
    dimensions: tuple[int, ...] = (2, 4, 8)
    trials: tuple[int, ...] = (50, 100, 200, 400)
    compared_trials: int = 100
    seeds: int = 3

    def __post_init__(self) -> None:
        """Check the fields."""
        checks.choice(self.algorithm, tuple(ALGORITHMS), "algorithm")
        for name in ("dimensions", "trials"):
            for index, value in enumerate(getattr(self, name)):
                checks.integer(value, name, index, at_least=1)
            if not getattr(self, name):
                raise StudyError("expected at least one", (name,))
        checks.integer(self.compared_trials, "compared_trials", at_least=1)
        checks.integer(self.seeds, "seeds", at_least=1)


def _check_published(published: Mapping[str, float]) -> None:
    for name, value in published.items():
        checks.choice(name, PUBLISHED, "published", name)
        checks.number(value, "published", name)
