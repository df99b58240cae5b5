"""Limits in the time response, and one time axis for all signals that were recorded."""

import numpy as np
from signal_runs import ANGLE, SETPOINT, record_run, signal_study

from bo_tuner.figures.figure import Band, Color, Dash, Line
from bo_tuner.metrics.recording import RecordedSignal, Recording
from bo_tuner.report.analysis import Analysis
from bo_tuner.report.sections import trajectories as drawn
from bo_tuner.report.sections.trajectories import Signal as Traced
from bo_tuner.report.sections.trajectories import panels, response, trajectories
from bo_tuner.storage.record import read_run
from bo_tuner.study.study_file import study_from_mapping

END = 2.0
STUDY = study_from_mapping(
    signal_study(
        signals={
            "setpoint": SETPOINT,
            "angle": ANGLE,
            "effort": {"topic": "/effort", "field": "data"},
        },
        metrics={
            "error": {"of": "setpoint - angle", "measure": "iae"},
            "largest_effort": {"of": "effort", "measure": "max"},
        },
        constraints={
            "effort": {
                "kind": "chance",
                "metric": "largest_effort",
                "upper": 0.5,
                "probability": 0.9,
            }
        },
    )
)


def recording(gain):
    """A set-point before the start, and signals that end before the run does."""
    time = np.linspace(0.0, 1.8, 91)
    return Recording(
        {
            "setpoint": RecordedSignal(np.array([-0.1]), np.array([1.0])),
            "angle": RecordedSignal(time, 1.0 - np.exp(-gain * time)),
            "effort": RecordedSignal(time, 0.25 * gain * np.exp(-time)),
        },
        END,
    )


def analysis_of(tmp_path):
    run = record_run(tmp_path / "run", STUDY, {0.5: [recording(0.5)], 1.5: [recording(1.5)]})
    return Analysis(read_run(run))


def lines(panel, name):
    return [e for e in panel.elements if isinstance(e, Line) and e.name == name]


def panels_of(analysis):
    """The panels of the first screen and those among the others, by their labels."""
    (figure,) = trajectories(analysis).figures
    shown = [*response(analysis).panels, *figure.panels]
    by_label = {panel.y.label: panel for panel in shown}
    # Each stands once.
    assert len(by_label) == len(shown)
    return by_label


def test_all_signals_have_one_time_axis_and_are_held_to_the_end(tmp_path):
    shown = panels_of(analysis_of(tmp_path))
    assert [panel.x.limits for panel in shown.values()] == [(0.0, END)] * 2
    drawn = [e for panel in shown.values() for e in panel.elements if isinstance(e, Line)]
    assert all((line.x[0], line.x[-1]) == (0.0, END) for line in drawn)
    (angle, *_) = lines(shown["setpoint and angle"], "default")
    assert angle.y[-1] == angle.y[-2] == 1.0 - np.exp(-0.5 * 1.8)


def test_the_set_point_is_drawn_once_over_the_signal_that_follows_it(tmp_path):
    shown = panels_of(analysis_of(tmp_path))
    assert {*shown} == {"setpoint and angle", "effort"}
    angle = shown["setpoint and angle"]
    (setpoint,) = lines(angle, "setpoint")
    assert (list(setpoint.x), list(setpoint.y)) == ([0.0, END], [1.0, 1.0])
    assert len(lines(angle, "best so far")) == 1


def test_what_is_over_a_limit_on_the_largest_value_is_shaded(tmp_path):
    analysis = analysis_of(tmp_path)
    effort = panels_of(analysis)["effort"]
    (band,) = [e for e in effort.elements if isinstance(e, Band)]
    (limit,) = lines(effort, "limit of largest_effort")
    assert list(limit.y) == [0.5, 0.5]
    assert list(band.lower) == [0.5, 0.5]
    low, high = effort.y.limits
    # Up to the edge, and all lines are on the axis.
    assert list(band.upper) == [high, high]
    assert low < min(min(e.y) for e in effort.elements if isinstance(e, Line))
    # It is what the first screen shows.
    shown = response(analysis)
    assert [panel.y.label for panel in shown.panels] == ["effort"]
    assert shown.title.startswith("How does the effort follow, ")


def test_the_first_screen_asks_for_two_signals_in_the_plural(tmp_path, monkeypatch):
    monkeypatch.setattr(drawn, "_main", lambda panels: panels[0].y.label)
    title = response(analysis_of(tmp_path)).title
    assert title.startswith("How do the setpoint and angle follow, ")


def test_a_trace_says_where_a_metric_is_zero(make_study):
    """The limit of 1 on the peak is 1 above that, wherever that is."""
    time, zero = np.array([0.0, 1.0, 2.0]), np.array([3.0, 4.0, 3.0])
    trace = {
        "time": Traced("s", time),
        "speed/actual": Traced("m/s", np.array([3.0, 5.5, 3.5])),
        "speed/peak = 0": Traced("m/s", zero),
        "force": Traced("N", np.zeros(3)),
    }
    looks = {"run": (Color.BLUE, Dash.SOLID)}
    speed, force = panels({"": {"run": trace}}, looks, make_study())
    (limit,) = lines(speed, "limit of peak")
    np.testing.assert_array_equal(limit.y, zero + 1.0)
    # The signal itself is no line, and other panels have no limit.
    assert not [e for e in speed.elements if getattr(e, "name", "").endswith("= 0")]
    assert [type(e) for e in force.elements] == [Line]
    without, _ = panels({"": {"run": trace}}, looks, None)
    assert [type(e) for e in without.elements] == [Line]
