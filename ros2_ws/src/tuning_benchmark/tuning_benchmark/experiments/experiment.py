"""Experiments: which studies, algorithms and optimizers a campaign compares, and how often."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any

import numpy as np

from bo_tuner.codec import checks
from bo_tuner.codec.rules import KEY
from bo_tuner.errors import StudyError
from bo_tuner.methods.registry import METHODS
from bo_tuner.study.study import Study
from bo_tuner.trials import Value
from tuning_benchmark.experiments.optima import Optimum, optimum_of
from tuning_benchmark.paper.reinterpolation_search import OBSERVED, POSTERIOR

RANDOM, WORST_CASE, OWN = "random", "worst_case", "own"

PUBLISHED = ("runs", "feasible", "objective", "difference", "best")
"""Numbers that the paper prints for a row, and the number of runs behind them."""


@dataclass(frozen=True, kw_only=True)
class Row:
    """A row of a table: an algorithm of the tuner, or another optimizer.

    Attributes
    ----------
    name
        Its label in the tables.
    algorithm
        Key of `METHODS`; or
    optimizer
        an optimizer, as ``module:Class``.
    protocol
        How a trial is evaluated. ``worst_case``: as in Algorithm IV, with the search for the worst
        context. ``random``: by `contexts` evaluations in drawn contexts; the largest metric
        observed is the constraint. ``own``: an optimizer chooses the context of each evaluation,
        see `peers.robust.RobustOptimizer`, and the initial trials are those of ``worst_case``; an
        algorithm has its own numbers of evaluations of a trial instead of the study's.
    contexts
        Evaluations of a trial under ``random``.
    evaluations
        Budget, if not the case's.
    worst_case, neighbour_starts
        Choices of stage two, if not the algorithm's.
    published
        The paper's numbers for this row; the keys are `PUBLISHED`.
    """

    name: Annotated[str, KEY]
    algorithm: str = ""
    optimizer: str = ""
    protocol: str = WORST_CASE
    contexts: int = 0
    evaluations: int | None = None
    worst_case: str = ""
    neighbour_starts: int | None = None
    published: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if bool(self.algorithm) == bool(self.optimizer):
            raise StudyError("expected either an algorithm or an optimizer")
        if self.algorithm:
            checks.choice(self.algorithm, tuple(METHODS), "algorithm")
        if self.optimizer:
            checks.matching(self.optimizer, checks.OBJECT_PATH, "module:Class", "optimizer")
        checks.choice(self.protocol, (RANDOM, WORST_CASE, OWN), "protocol")
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
    """A parameter set to judge.

    Attributes
    ----------
    parameters
        Value of each tuned parameter.
    neighbours
        Whether its neighbours are listed; its verdict needs them in any case.
    published
        The paper's numbers for it; the keys are `PUBLISHED`.
    """

    parameters: Mapping[str, Value]
    neighbours: bool = False
    published: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        checks.boolean(self.neighbours, "neighbours")
        _check_mapping(self.parameters, "parameters")
        _check_published(self.published)


@dataclass(frozen=True, kw_only=True)
class SurrogateFigure:
    """Run whose final surrogates are shown, and the grid they are shown on.

    Attributes
    ----------
    row, seed
        The run.
    points
        Grid values of each real parameter; of an integer all values are on the grid.
    """

    row: str
    seed: int = 1
    points: int = 25

    def __post_init__(self) -> None:
        checks.integer(self.seed, "seed", at_least=1)
        checks.integer(self.points, "points", at_least=2)

    def axes(self, study: Study) -> list[list[Value]]:
        """Grid values of each tuned parameter of a study."""
        space = study.search_space()
        return [
            list(range(int(lower), int(upper) + 1))
            if integer
            else [round(float(v), 9) for v in np.linspace(lower, upper, self.points)]
            for lower, upper, integer in zip(space.lower, space.upper, space.integer, strict=True)
        ]


@dataclass(frozen=True, kw_only=True)
class Calibration:
    """A metric that is modelled in the campaign, beside what is measured.

    Attributes
    ----------
    study
        Its nodes run the evaluations.
    metric, key
        The metric, and the node's name of the figure to compare if that is another one: on a shared
        computer the median of measured times is more reliable than a high quantile.
    node, parameter
        Parameter that selects the source of the metric.
    modelled, measured
        Its two values.
    grid
        Values of some tuned parameters; all permitted combinations are evaluated.
    repeats
        Measured evaluations of each.
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
        checks.reference(self.metric, "metric", self.study.metrics, "metric")
        checks.text(self.key, "key")
        checks.reference(self.node, "node", self.study.nodes, "node")
        checks.parameter_name(self.parameter, "parameter")
        checks.integer(self.repeats, "repeats", at_least=1)
        for name in self.grid:
            checks.reference(name, "parameter", self.study.parameters, "grid", name)


@dataclass(frozen=True, kw_only=True)
class Cost:
    """How the cost of a run grows, on a study in closed form whose evaluations cost nothing.

    Attributes
    ----------
    algorithm
        Key of `METHODS`.
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
        checks.choice(self.algorithm, tuple(METHODS), "algorithm")
        for name in ("dimensions", "trials"):
            for index, value in enumerate(getattr(self, name)):
                checks.integer(value, name, index, at_least=1)
            if not getattr(self, name):
                raise StudyError("expected at least one", (name,))
        checks.integer(self.compared_trials, "compared_trials", at_least=1)
        checks.integer(self.seeds, "seeds", at_least=1)


@dataclass(frozen=True, kw_only=True)
class Case:
    """Rows that are compared on one study.

    Attributes
    ----------
    name
        Short name, also used for its figures.
    title
        Heading on the page.
    study
        The study.
    runs
        Runs of each row, with seeds 1, 2, ...; those with one seed start from the same samples.
    evaluations
        Budget of a run, whose last trial is the one that reaches it.
    reserved_evaluations
        Part of the budget that is kept for algorithms that check their candidates before they
        answer; it limits the number of candidates checked.
    initial_trials
        Size of the initial design, if not the study's.
    rows
        What is compared.
    surrogates
        Figure of a run's final surrogates, beside the true map; for two tuned parameters.
    points
        Parameter sets to judge, by name.
    remarks
        Hand-written comments on the results, below the tables.
    """

    name: str
    title: str
    study: Study
    runs: int
    evaluations: int
    reserved_evaluations: int = 0
    initial_trials: int | None = None
    rows: Mapping[str, Row]
    surrogates: SurrogateFigure | None = None
    points: Mapping[str, Point] = field(default_factory=dict)
    remarks: str = ""

    def __post_init__(self) -> None:
        checks.matching(self.name, checks.SIMPLE_NAME, "a name of letters, digits, _ and -", "name")
        checks.text(self.title, "title")
        checks.text(self.remarks, "remarks")
        checks.integer(self.runs, "runs", at_least=1)
        checks.integer(self.evaluations, "evaluations", at_least=1)
        checks.integer(self.reserved_evaluations, "reserved_evaluations", at_least=0)
        if self.reserved_evaluations >= self.evaluations:
            raise StudyError(
                f"expected less than the {self.evaluations} evaluations",
                ("reserved_evaluations",),
            )
        if self.initial_trials is not None:
            checks.integer(self.initial_trials, "initial_trials", at_least=1)
        if not self.rows:
            raise StudyError("expected at least one", ("rows",))
        space = self.study.search_space()
        if self.surrogates is not None:
            checks.reference(self.surrogates.row, "row", self.rows, "surrogates", "row")
            if space.dimension != 2 or not self.rows[self.surrogates.row].algorithm:
                raise StudyError(
                    "expected an algorithm on a study of two tuned parameters", ("surrogates",)
                )
        for name, point in self.points.items():
            try:
                space.to_cube(point.parameters)
            except ValueError as error:
                raise StudyError(str(error), ("points", name, "parameters")) from None

    def budget(self, row: Row) -> int:
        """Return the evaluations of a run of a row."""
        return self.evaluations if row.evaluations is None else row.evaluations


@dataclass(frozen=True, kw_only=True)
class Experiment:
    """A campaign's content; read it by `experiment_file.load_experiment`.

    Attributes
    ----------
    name, title, description
        Shown on the page.
    judge
        Class that computes the truth, as ``module:Class``; see `judging.truth.Judge`.
    optima
        Results of `benchmarks/grid_search.py` by name of the study.
    cases
        What is compared.
    calibration, cost
        Further figures, if asked for.
    """

    name: str
    title: str = ""
    description: str = ""
    judge: str
    optima: Mapping[str, Any] = field(default_factory=dict)
    cases: Mapping[str, Case]
    calibration: Calibration | None = None
    cost: Cost | None = None

    def __post_init__(self) -> None:
        checks.matching(self.name, checks.SIMPLE_NAME, "a name of letters, digits, _ and -", "name")
        checks.text(self.title, "title")
        checks.text(self.description, "description")
        checks.matching(self.judge, checks.OBJECT_PATH, "module:Class", "judge")
        if not self.cases:
            raise StudyError("expected at least one", ("cases",))

    def optimum(self, study: Study) -> Optimum | None:
        """Return what is known of a study's optimum; None if it is not known."""
        return optimum_of(self.optima, study)


def _check_mapping(value: object, key: str) -> None:
    if not isinstance(value, Mapping):
        raise StudyError(f"expected a mapping, found {checks.show(value)}", (key,))


def _check_published(published: Mapping[str, float]) -> None:
    _check_mapping(published, "published")
    for name, value in published.items():
        checks.choice(name, PUBLISHED, "published", name)
        checks.number(value, "published", name)
