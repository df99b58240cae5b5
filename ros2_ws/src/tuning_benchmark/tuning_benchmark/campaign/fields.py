"""Final surrogates and the truth over the plane of two tuned parameters (Fig. 5)."""

from typing import Any

import numpy as np

from bo_tuner.models.surrogates import Classifier
from bo_tuner.numerics.arrays import Array
from bo_tuner.numerics.seeds import Stream, generator
from bo_tuner.study.search_space import SearchSpace
from bo_tuner.study.study import Study
from bo_tuner.trials import TrialState, Value
from tuning_benchmark.campaign.runs import Run, RunSize
from tuning_benchmark.experiments.experiment import Row, SurrogateFigure
from tuning_benchmark.judging.evaluator import Evaluator
from tuning_benchmark.judging.truth import Effort, Truth

EFFORT = Effort(drawn=200, grid=5)
"""For each point of the true fields; enough for a figure."""


def surrogate_fields(
    study: Study, row: Row, size: RunSize, figure: SurrogateFigure
) -> dict[str, Any]:
    """Repeat a run and evaluate its final surrogates on a grid.

    Returns
    -------
    dict
        ``names`` of the tuned parameters and their ``axes``; fields over these, one list for each
        value of the first: ``objective``, the constrained responses in ``constraints``,
        ``feasibility``, ``failure`` and ``outlier``; ``samples``, the trials; and the parameter
        sets of the ``answer``, None without one, and the ``default``.
    """
    run = Run(study, row, figure.seed, size)
    for _ in run:
        pass
    answer = run.answer()
    trials = run.trials
    rng = generator(run.study.seed, Stream.ACQUISITION, 2**31, len(trials))
    models = run.method.ranking.fit(run.study, trials, rng=rng)
    space = study.search_space()
    first, second = figure.axes(study)
    grid = np.array([_cube(space, a, b) for a in first for b in second])
    shape = (len(first), len(second))

    def field(values: Array) -> list[list[float]]:
        rows: list[list[float]] = np.round(values.reshape(shape), 6).tolist()
        return rows

    def probability(classifier: Classifier | None) -> list[list[float]]:
        return field(np.zeros(len(grid)) if classifier is None else classifier.probability(grid))

    return {
        "names": list(space.names),
        "axes": [first, second],
        "objective": None
        if models.objective is None
        else field(study.objective.from_cost(models.objective.predict(grid)[0])),
        "constraints": {
            name: {"field": field(model.predict(grid)[0]), "limit": model.limit}
            for name, model in models.constraints.items()
        },
        "feasibility": field(np.exp(models.log_feasibility(grid))),
        "failure": probability(models.failures),
        "outlier": probability(models.outlying),
        "samples": [
            {
                "point": [t.parameters[name] for name in space.names],
                "failed": t.state is TrialState.FAILED,
                "outlier": t.number in models.outliers,
            }
            for t in trials
        ],
        "answer": None
        if answer is None
        else [trials[answer[0]].parameters[name] for name in space.names],
        "default": [space.defaults[name] for name in space.names],
    }


def true_fields(study: Study, judge: str, figure: SurrogateFigure, first: Value) -> dict[str, Any]:
    """Judge the grid where the first tuned parameter has one value.

    Returns
    -------
    dict
        Over the second parameter: ``objective``, ``worst``, and in ``constraints`` each chance
        constraint's metric in one evaluation in the nominal context.
    """
    truth = Truth(study, judge, EFFORT)
    evaluator = Evaluator(study)
    space = study.search_space()
    fields: dict[str, Any] = {"objective": [], "worst": [], "constraints": {}}
    for second in figure.axes(study)[1]:
        parameters = space.to_parameters(_cube(space, first, second))
        judged = truth.judge.judge(study.assignments(parameters, {}, 0))
        fields["objective"].append(_number(judged.objective))
        fields["worst"].append(_number(judged.worst))
        metrics = evaluator.metrics(parameters)
        for constraint in study.drawn_constraints:
            value = metrics.get(constraint.metric, np.nan)
            fields["constraints"].setdefault(constraint.name, []).append(_number(value))
    return fields


def _cube(space: SearchSpace, first: Value, second: Value) -> Array:
    return space.to_cube(dict(zip(space.names, (first, second), strict=True)))


def _number(value: float) -> float | None:
    return round(float(value), 6) if np.isfinite(value) else None
