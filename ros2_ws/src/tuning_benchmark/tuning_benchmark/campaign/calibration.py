"""A metric that a campaign takes from a model, beside the same metric as measured."""

import dataclasses
import itertools
from typing import Any

from bo_tuner.errors import ParameterError
from bo_tuner.study.metrics import ReportedMetric
from bo_tuner.study.study import Study
from tuning_benchmark.experiments.experiment import Calibration
from tuning_benchmark.judging.evaluator import Evaluator

REPAIRED = 1e-9
"""A parameter moved by more was repaired, since the order of two did not hold."""


def calibrate(calibration: Calibration) -> dict[str, Any]:
    """Evaluate a grid in the nominal context, with the metric modelled and measured.

    Other tuned parameters have their defaults. Points that the study does not permit are left out.

    Returns
    -------
    dict
        ``points``, each with its ``parameters``, the ``modelled`` value and the ``measured`` ones.
    """
    metric = calibration.metric
    modelled = Evaluator(_variant(calibration, calibration.modelled))
    measured = Evaluator(_variant(calibration, calibration.measured))
    space = calibration.study.search_space()
    points = []
    for values in itertools.product(*calibration.grid.values()):
        tuned = {name: space.defaults[name] for name in space.names}
        tuned |= dict(zip(calibration.grid, values, strict=True))
        try:
            parameters = space.to_parameters(space.to_cube(tuned))
        except ParameterError:
            continue
        if any(
            abs(float(parameters[name]) - float(value)) > REPAIRED for name, value in tuned.items()
        ):
            continue
        repeats = range(calibration.repeats)
        points.append(
            {
                "parameters": parameters,
                "modelled": modelled.metrics(parameters).get(metric),
                "measured": [measured.metrics(parameters).get(metric) for _ in repeats],
            }
        )
    return {"points": points}


def _variant(calibration: Calibration, value: str) -> Study:
    study = calibration.study
    node = study.nodes[calibration.node]
    changed = dataclasses.replace(
        node, inprocess_parameters={**node.inprocess_parameters, calibration.parameter: value}
    )
    metric = study.metrics[calibration.metric]
    if calibration.key and isinstance(metric, ReportedMetric):
        metric = dataclasses.replace(metric, key=calibration.key)
    return dataclasses.replace(
        study,
        nodes={**study.nodes, calibration.node: changed},
        metrics={**study.metrics, calibration.metric: metric},
    )
