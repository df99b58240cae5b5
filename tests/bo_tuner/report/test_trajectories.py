"""Trajectories: what the trigger's object traces, and what is said if it does not."""

import sys

import numpy as np
import pytest

from bo_tuner.report.analysis import Analysis
from bo_tuner.report.sections.trajectories import response, trajectories


@pytest.fixture
def section_of(axis_run, monkeypatch):
    """Function that makes the section of a run on another object."""
    from report_runs import with_ends

    def make(name):
        run = axis_run(**with_ends(2.0, object=f"report_objects:{name}"))
        monkeypatch.syspath_prepend(str(run.path.parents[1]))
        return Analysis(run), trajectories(Analysis(run))

    return make


def test_signals_of_a_group_share_a_panel(section_of):
    analysis, section = section_of("Traced")
    (others,) = section.figures
    first = response(analysis)
    # Each stands once: that which matters most on the first screen, on the same axes.
    for figure, title in ((first, "position [m]"), (others, "force [N]")):
        assert figure.columns == 2
        titles = [(panel.title, panel.y.title) for panel in figure.panels]
        assert titles == [("nominal context", title), ("worst context", title)]
    assert first.panels[0].y == first.panels[1].y
    reference, default, tuned = first.panels[0].elements
    # What is equal for both is drawn once.
    assert (reference.name, default.name, tuned.name) == ("reference", "default", "tuned")
    np.testing.assert_allclose(default.y, 0.5 * np.arange(5))
    gain = analysis.answer.parameters["gain"]
    np.testing.assert_allclose(tuned.y, gain * np.arange(5))
    np.testing.assert_allclose(tuned.x, 0.1 * np.arange(5))


def test_an_object_without_signals_is_told(section_of):
    _, section = section_of("Axis")
    assert section.figures == ()
    assert "the object of node 'axis' has no trace()" in section.lead


def test_signals_without_a_time_are_told(section_of):
    _, section = section_of("Untold")
    assert section.figures == ()
    assert "expected 'time' and other signals of the same length" in section.lead


@pytest.mark.parametrize("name", ["Blank", "OnlyTime"])
def test_signals_without_a_value_are_told(section_of, name):
    _, section = section_of(name)
    assert section.figures == ()
    assert "of the same length, at least one value each" in section.lead


def test_an_object_that_cannot_be_had_is_told(monkeypatch, analysis):
    # Wherever it lies: runs of other tests leave folders with such a module on the path.
    monkeypatch.setitem(sys.modules, "report_objects", None)
    section = trajectories(analysis)
    assert section.figures == ()
    assert "cannot load report_objects:Traced" in section.lead
