"""The response of a single run."""

import numpy as np

from bo_tuner.figures.figure import Color, Dash, Line
from bo_tuner.report.sections.trajectories import STYLES, Signal
from bo_tuner.report.single_run import traced_response
from bo_tuner.trials import TUNED


def test_signals_in_one_panel_can_be_told_apart(make_study):
    time = np.linspace(0.0, 1.0, 5)
    trace = {
        "time": Signal("s", time),
        "angle/reference": Signal("rad", np.ones(5)),
        "angle/measured": Signal("rad", time),
    }
    (panel,) = traced_response(make_study(), trace)
    lines = {item.name: item for item in panel.elements if isinstance(item, Line)}
    assert list(lines) == ["this run, reference", "this run, measured"]
    # The reference as in all figures, and unlike what follows it.
    styles = [(line.color, line.dash) for line in lines.values()]
    assert styles == [(Color.INK, Dash.DOTTED), STYLES[TUNED]]
