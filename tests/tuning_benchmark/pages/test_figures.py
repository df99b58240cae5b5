import numpy as np
import pytest

from bo_tuner.figures.figure import Band, Contour, Heatmap, Line, Points
from bo_tuner.study.study_file import load_study
from tuning_benchmark.campaign.fields import surrogate_fields, true_fields
from tuning_benchmark.campaign.runs import RunSize
from tuning_benchmark.experiments.experiment import (
    Calibration,
    Cost,
    Row,
    SurrogateFigure,
)
from tuning_benchmark.pages import figures
from tuning_benchmark.pages.field_figure import field_figure
from tuning_benchmark.pages.summary import summarize

JUDGE = "valley:Judge"
FIGURE = SurrogateFigure(row="IV", points=4)


def drawn(panel, kind):
    return [element for element in panel.elements if isinstance(element, kind)]


def test_convergence_shows_medians_of_the_feasible(make_case, record, answer):
    case = make_case(rows={"A": Row(name="A", algorithm="IV")}, runs=2)
    incumbents = {
        "1": {"objective": 3.0, "feasible": True}, "2": {"objective": 1.0, "feasible": False}
    }  # fmt: skip
    way = [[(20, 1)], [(20, 1), (60, 2)]]
    done = {f"run/c/A/{s + 1}": record(answer(), way[s], incumbents) for s in (0, 1)}
    done["run/c/A/1"]["result"]["incumbents"]["1"] = {"objective": 2.0, "feasible": True}
    done["run/c/A/2"]["result"]["incumbents"] = {
        "1": {"objective": 4.0, "feasible": True}, "2": incumbents["2"]
    }  # fmt: skip
    figure = figures.convergence(case, [summarize(case, case.rows["A"], done, None)], None)
    quality, share = (drawn(panel, Line)[0] for panel in figure.panels)

    def at(line, evaluations):
        return line.y[np.searchsorted(line.x, evaluations)]

    assert np.isnan(at(quality, 5))
    assert (at(quality, 30), at(quality, 80)) == (3.0, 2.0)
    assert (at(share, 5), at(share, 30), at(share, 80)) == (0.0, 1.0, 0.5)


def incumbent_figure(make_case, record, answer, objectives, optimum=None):
    """Figure of a row whose runs each have one incumbent, from evaluation 20 on."""
    case = make_case(rows={"A": Row(name="A", algorithm="IV")}, runs=len(objectives))
    done = {
        f"run/c/A/{seed}": record(
            answer(), [(20, 1)], {"1": {"objective": value, "feasible": True}}
        )
        for seed, value in enumerate(objectives, start=1)
    }
    return figures.convergence(case, [summarize(case, case.rows["A"], done, None)], optimum)


def test_quality_is_above_the_optimum_on_an_axis_from_zero(make_case, record, answer):
    objectives = [1.0, 1.1, 1.2, 1.3, 10.0]
    quality, _ = incumbent_figure(make_case, record, answer, objectives, optimum=1.0).panels
    (median,), (quartiles,) = (drawn(quality, kind) for kind in (Line, Band))
    assert median.y[-1] == pytest.approx(20.0)
    assert (quartiles.lower[-1], quartiles.upper[-1]) == pytest.approx((10.0, 30.0))
    low, high = quality.y.limits
    # An outlier does not stretch it.
    assert low == 0.0
    assert 20.0 < high < 30.0
    assert quality.y.unit == "%"


def test_without_an_optimum_the_axis_is_that_of_the_metric(make_case, record, answer):
    quality, _ = incumbent_figure(make_case, record, answer, [3.0, 4.0, 5.0]).panels
    assert drawn(quality, Line)[0].y[-1] == 4.0
    assert quality.y.limits[0] == 0.0


def test_each_row_has_a_colour_of_its_own(make_case, record, answer):
    rows = {name: Row(name=name, algorithm="IV") for name in "ABCDE"}
    case = make_case(rows=rows, runs=1)
    incumbents = {"1": {"objective": 1.0, "feasible": True}}
    done = {f"run/c/{name}/1": record(answer(), [(20, 1)], incumbents) for name in rows}
    found = [summarize(case, row, done, None) for row in rows.values()]
    figure = figures.convergence(case, found, 1.0)
    assert len(figure.panels) == figure.columns == 2
    assert len({line.color for line in drawn(figure.panels[0], Line)}) == 5


@pytest.fixture(scope="module")
def fields(study):
    row = Row(name="IV", algorithm="IV")
    surrogates = surrogate_fields(study, row, RunSize(40, 0, 4), FIGURE)
    truth = [true_fields(study, JUDGE, FIGURE, first) for first in FIGURE.axes(study)[0]]
    return surrogates, truth


def test_fields_stand_upright(make_case, fields):
    """The second parameter runs upwards: rows of a heatmap are its values."""
    case = make_case(rows={"IV": Row(name="IV", algorithm="IV")}, surrogates=FIGURE)
    surrogates, truth = fields
    figure = field_figure(case, FIGURE, surrogates, truth)
    titles = [panel.title for panel in figure.panels]
    assert titles == [
        "error, surrogate", "error, truth", "peak, surrogate", "peak, truth",
        "predicted probabilities", "feasible in truth",
    ]  # fmt: skip
    assert figure.columns == 2
    worst = next(p for p in figure.panels if p.title == "peak, truth")
    (heat,) = drawn(worst, Heatmap)
    assert heat.z[3][0] == truth[0]["worst"][3]
    (contour,) = [c for c in drawn(worst, Contour) if c.name == "feasible in truth"]
    assert contour.z[0][0] == 1.0
    assert contour.z[3][3] == 0.0
    surrogate = figure.panels[0]
    assert sum(len(points.x) for points in drawn(surrogate, Points)) == len(
        surrogates["samples"]
    ) + len(("default", "answer"))


def calibration(key):
    """A calibration of the computing time that compares a key."""
    return Calibration(
        study=load_study("full"), metric="return_time", key=key, node="controller",
        parameter="return_time", modelled="modelled", measured="measured", grid={}, repeats=2,
    )  # fmt: skip


@pytest.mark.parametrize(
    ("key", "words"), [("return_time_p50", "the study limits return_time_p99"), ("", "median.")]
)
def test_calibration_compares_by_a_line(key, words):
    given = calibration(key)
    points = [{"modelled": x, "measured": [1.0 + 0.25 * x, 9.0]} for x in (1.0, 2.0, 4.0)]
    points.append({"modelled": None, "measured": [1.0]})
    figure, text = figures.calibration(given, {"points": points})
    assert text.startswith("Measured = 1 s + 0.25 × modelled, over 3 settings; correlation 1.000.")
    assert "4.0 times as long" in text
    assert figure.caption.rstrip(".").endswith(words.rstrip("."))


@pytest.mark.parametrize(
    ("points", "count"),
    [
        ([{"modelled": None, "measured": [None]}] * 2, "0 of 2"),
        ([{"modelled": 1.0, "measured": [1.0]}] * 2, "2 of 2"),
    ],
)
def test_calibration_without_a_line_says_so(points, count):
    """As where the key of the measured figure is misspelt."""
    figure, text = figures.calibration(calibration("typo"), {"points": points})
    assert figure is None
    assert text.startswith(f"No line: {count} settings have a modelled and a measured typo")


def cost_figure(seconds):
    """Figure and text of costs by number of parameters and seed, at 50, 100 and 200 trials."""
    seeds = max(seed for _, seed in seconds)
    cost = Cost(dimensions=(2, 4), trials=(50, 100, 200), compared_trials=100, seeds=seeds)
    done = {
        f"cost/{dimension}/{seed}": {
            "result": {"trials": [50, 100, 200] if dimension == 2 else [100], "seconds": values}
        }
        for (dimension, seed), values in seconds.items()
    }
    return figures.cost_scaling(cost, done)


def test_cost_grows_by_the_power_that_was_put_in():
    figure, text = cost_figure({(2, 1): [1.0, 2.0, 16.0], (4, 1): [4.0]})
    assert "with the trials to the power 2.00 (one run); 1.00 from 50 to 100, 3.00 from" in text
    assert "with the parameters to the power 1.00 (one run)." in text
    assert "The lines in the figure are fits." in text
    assert len(figure.panels) == 2


def test_an_exponent_has_the_interval_of_its_seeds():
    """A run's own times depend on each other: only runs tell how sure an exponent is."""
    seconds = {
        (2, seed): [seed * (trials / 50) ** power for trials in (50, 100, 200)]
        for seed, power in enumerate((1.0, 1.5, 2.0), start=1)
    }
    # Four parameters cost 2, 4 and 8 times as much as two.
    seconds |= {(4, seed): [2.0**seed * seconds[2, seed][1]] for seed in (1, 2, 3)}
    figure, text = cost_figure(seconds)
    # 0.975 quantile of Student's t with 2 degrees of freedom, from a printed table.
    half = 4.303 * np.std([1.0, 1.5, 2.0], ddof=1) / np.sqrt(3)
    shown = f"{1.5:.2f} ({1.5 - half:.2f} to {1.5 + half:.2f}, 3 seeds)"
    assert f"the trials to the power {shown}; 1.50 from 50 to 100, 1.50 from 100 to 200." in text
    assert "the parameters to the power 2.00 (-0.48 to 4.48, 3 seeds)." in text
    (line,), (points,) = drawn(figure.panels[0], Line), drawn(figure.panels[0], Points)
    # The mean of the runs' lines: factors 1, 2 and 3 at 50 trials.
    assert line.y[0] == pytest.approx(6.0 ** (1 / 3))
    assert len(points.x) == 9
