"""Parallel coordinates of studies with many parameters."""

import numpy as np
import pytest

from bo_tuner.report.analysis import Analysis
from bo_tuner.report.sections.parallel import parallel

MANY = {
    name: {"node": "axis", "type": "double", "bounds": [0.0, 2.0], "default": 0.5}
    for name in ("gain", "b", "c", "d")
}


def test_few_parameters_need_none(analysis):
    assert parallel(analysis) is None


def test_each_line_has_the_places_of_its_trial(axis_run):
    analysis = Analysis(axis_run(parameters=MANY))
    section = parallel(analysis)
    assert section is not None
    (panel,) = section.figures[0].panels
    # Each axis says where it ends.
    assert {text for _, text in panel.x.ticks} == {f"{name}\n0 … 2" for name in MANY}
    (tuned,) = [line for line in panel.elements if line.name == "tuned"]
    places = [analysis.answer.parameters[name.split("\n")[0]] / 2.0 for _, name in panel.x.ticks]
    assert list(tuned.y[:4]) == pytest.approx(places)
    drawn = sum(int(np.isnan(line.y).sum()) for line in panel.elements if line is not tuned)
    assert drawn == sum(
        analysis.outcome(trial) in ("within limits", "over the limit") for trial in analysis.trials
    )
