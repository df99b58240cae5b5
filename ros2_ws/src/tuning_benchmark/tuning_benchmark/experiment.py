"""Experiments: which studies, algorithms and optimizers a campaign compares, and how often."""

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from bo_tuner.errors import StudyError
from bo_tuner.study import checks
from bo_tuner.study.study import Study
from tuning_benchmark.experiment_parts import Calibration, Cost, Point, Row, SurrogateFigure


@dataclass(frozen=True, kw_only=True)
class Case:
    """Rows that are compared on one study.

    Attributes
    ----------
    name
        Short name, also of its figures.
    title
        Heading on the page.
    study
        The study.
    runs
        Runs of each row, with seeds 1, 2, ...; those with one seed start from the same samples.
    cuts
        Budget of a run: a run's trials end with the one that reaches it.
    reserved_cuts
        So many of them are left to an algorithm that checks its candidates before it answers, and
        it checks no more candidates than they suffice for.
    initial_trials
        Size of the initial design, if not the study's.
    rows
        What is compared.
    surrogates
        Figure of a run's final surrogates, beside the true map; for two tuned parameters.
    points
        Parametrizations to judge, by name.
    remarks
        What people have to say of the outcome, below the tables.
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
        """Check the fields."""
        checks.matching(self.name, checks.SIMPLE_NAME, "a name of letters, digits, _ and -", "name")
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
        """Cuts of a run of a row."""
        return self.evaluations if row.evaluations is None else row.evaluations


@dataclass(frozen=True, kw_only=True)
class Experiment:
    """A campaign's content; read it by `experiment_file.load_experiment`.

    Attributes
    ----------
    name, title, description
        For people.
    judge
        Class that knows the truth, as ``module:Class``; see `truth.Judge`.
    optima
        What a grid search found, by name of the study: ``optimum`` and ``default``, as in
        `benchmarks/grid_search.py`.
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
        """Check the fields."""
        checks.matching(self.name, checks.SIMPLE_NAME, "a name of letters, digits, _ and -", "name")
        checks.matching(self.judge, checks.OBJECT_PATH, "module:Class", "judge")
        if not self.cases:
            raise StudyError("expected at least one", ("cases",))

    def optimum(self, study: Study) -> float | None:
        """Objective of a study's grid optimum; None if it was not searched."""
        entry = self.optima.get(study.name)
        return None if entry is None else float(entry["optimum"]["E"])


def read_optima(path: Path) -> dict[str, Any]:
    """Read a file of `benchmarks/grid_search.py`.

    Raises
    ------
    StudyError
        If it cannot be read.
    """
    try:
        entries = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise StudyError(f"cannot read {path}: {error}", ("truth",)) from None
    if not isinstance(entries, dict):
        raise StudyError(f"{path}: expected an object of studies", ("truth",))
    return entries
