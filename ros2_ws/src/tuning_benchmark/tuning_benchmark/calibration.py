"""A metric that a campaign takes from a model, beside the same metric as measured."""

import dataclasses
import itertools
from typing import Any

import numpy as np

from bo_tuner.backends.inprocess import InProcessBackend
from bo_tuner.errors import ParameterError
from bo_tuner.study.study import Study
from bo_tuner.trials import Evaluation, EvaluationState, Stage
from bo_tuner.tuning.evaluation import evaluate
from bo_tuner.tuning.observer import NOBODY
from tuning_benchmark.experiment_parts import Calibration

REPAIRED = 1e-9
"""A parameter moved by more was repaired, since the order of two did not hold."""


def calibrate(calibration: Calibration) -> dict[str, Any]:
    """Cut each point of the grid in the nominal context, with the metric modelled and measured.

    Other tuned parameters have their defaults. Points that the study does not permit are left out.

    Returns
    -------
    dict
        ``points``, each with its ``parameters``, the ``modelled`` value and the ``measured`` ones.
    """
    study = calibration.study
    modelled = _variant(calibration, calibration.modelled)
    measured = _variant(calibration, calibration.measured)
    space = study.search_space()
    points = []
    for values in itertools.product(*calibration.grid.values()):
        tuned = {name: space.defaults[name] for name in space.names}
        tuned |= dict(zip(calibration.grid, values, strict=True))
        try:
            parameters = space.to_parameters(space.to_cube(tuned))
        except ParameterError:
            continue
        if any(abs(parameters[name] - value) > REPAIRED for name, value in tuned.items()):
            continue
        points.append(
            {
                "parameters": parameters,
                "modelled": _evaluation(modelled, calibration.metric, parameters),
                "measured": [
                    _evaluation(measured, calibration.metric, parameters)
                    for _ in range(calibration.repeats)
                ],
            }
        )
    return {"points": points}


def _variant(calibration: Calibration, value: str) -> tuple[Study, InProcessBackend]:
    study = calibration.study
    node = study.nodes[calibration.node]
    changed = dataclasses.replace(
        node, inprocess_parameters={**node.inprocess_parameters, calibration.parameter: value}
    )
    metric = study.metrics[calibration.metric]
    if calibration.key:
        metric = dataclasses.replace(metric, key=calibration.key)
    study = dataclasses.replace(
        study,
        nodes={**study.nodes, calibration.node: changed},
        metrics={**study.metrics, calibration.metric: metric},
    )
    backend = InProcessBackend(study)
    backend.open()
    return study, backend


def _evaluation(
    variant: tuple[Study, InProcessBackend], metric: str, parameters: dict[str, int | float]
) -> float | None:
    study, backend = variant
    contexts = study.context_space()
    context = contexts.to_dict(contexts.nominal())
    planned = Evaluation(0, 0, Stage.NOMINAL, parameters, context, 1)
    outcome = evaluate(study, backend, planned, NOBODY).outcome
    if outcome.state is not EvaluationState.COMPLETE or not np.isfinite(outcome.metrics[metric]):
        return None
    return outcome.metrics[metric]
