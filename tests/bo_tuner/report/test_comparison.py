"""Runs side by side: each run says on the page what its own report says."""

import sys
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from in_process import call

from bo_tuner.cli import report as report_command
from bo_tuner.evidence.words.verdict import basis, mark_in_words, page_title
from bo_tuner.report.analysis import Analysis
from bo_tuner.report.comparison import comparison, names
from bo_tuner.report.content import number


@pytest.fixture(scope="module")
def both(analysis, axis_run):
    """Two runs: one whose trials with large gains fail, and one that finds nothing feasible."""
    never = {"kind": "worst_case", "metric": "peak", "upper": -1.0}
    return [analysis, Analysis(axis_run(constraints={"never": never}))]


@pytest.fixture(scope="module")
def parts(both):
    return {s.name: s for s in comparison(dict(zip(names(both), both, strict=True)))}


def rows(section):
    (table,) = section.tables
    return {row[0]: row[1:] for row in table.rows}


def test_the_verdicts_are_those_of_the_runs(both, parts):
    found = rows(parts["verdicts"])
    for name, analysis in zip(names(both), both, strict=True):
        state, told, trial, evidence, *_ = found[name]
        assert (state, told) == (mark_in_words(analysis.verdict), page_title(analysis.verdict))
        assert trial == str(analysis.verdict.trial)
        assert evidence == basis(analysis.verdict)
    good, bad = both
    assert (good.verdict.feasible, bad.verdict.feasible) == (True, False)
    assert found[names(both)[1]][:2] == [
        "not feasible",
        "No feasible parameter set was found: no trial keeps the limit of peak",
    ]


def test_parameters_and_numbers_stand_side_by_side(both, parts):
    results = [number(analysis.answer.parameters["gain"]) for analysis in both]
    ((name, values),) = rows(parts["parameters"]).items()
    assert name.startswith("gain [")
    *values, difference = values
    assert values == [f"{result} (0.5)" for result in results]
    first, second = (analysis.answer.parameters["gain"] for analysis in both)
    assert float(difference.split()[0]) == pytest.approx(second - first, rel=1e-3)
    (cells,) = [cells for name, cells in rows(parts["numbers"]).items() if "mean error" in name]
    *cells, _ = cells
    for cell, analysis in zip(cells, both, strict=True):
        (quantity,) = [q for q in analysis.verdict.quantities if q.label == "mean error"]
        assert cell.startswith(f"{number(quantity.tuned)} ({number(quantity.default)})")
        assert cell.endswith(str(quantity.change))
    assert any("NOT kept" in of_run[1] for of_run in rows(parts["numbers"]).values())


def test_values_in_other_units_have_rows_of_their_own(both):
    first, _ = both
    study = first.study
    other = replace(
        study,
        parameters={"gain": replace(study.parameters["gain"], unit="ms")},
        metrics={**study.metrics, "peak": replace(study.metrics["peak"], unit="kN")},
    )
    runs = {"N": first, "kN": Analysis(replace(first.record, study=other))}
    found = {s.name: s for s in comparison(runs)}
    assert rows(found["parameters"])["gain [ms]"][0] == "–"
    numbers = rows(found["numbers"])
    in_kilonewtons = [cells for name, cells in numbers.items() if name.endswith("[kN]")]
    assert in_kilonewtons
    assert [cells for name, cells in numbers.items() if name.endswith("[N]")] == [
        [value, "–", "–"] for _, value, _ in in_kilonewtons
    ]


def test_the_last_column_has_the_difference(both):
    """Of two runs the second minus the first, of more the largest minus the smallest."""
    runs = []
    for gain in (0.2, 0.5, 0.4):
        answer = replace(both[0].answer, parameters={"gain": gain})
        run = Analysis(both[0].record)
        # What is computed once is kept under its name.
        vars(run)["answer"] = answer
        runs.append(run)

    def last(*chosen):
        parts = {s.name: s for s in comparison(dict(zip("abc", chosen, strict=False)))}
        (table,) = parts["parameters"].tables
        return table.header[-1], table.rows[0][-1]

    assert last(runs[0], runs[1]) == ("difference", "+0.3 (+150.0 %)")
    assert last(runs[1], runs[0]) == ("difference", "-0.3 (-60.0 %)")
    assert last(runs[0], runs[0]) == ("difference", "none")
    assert last(*runs) == ("largest difference", "0.3")


def test_a_run_without_an_incumbent_is_named(both, parts):
    (figure,) = parts["convergence"].figures
    lines = [line.name for panel in figure.panels for line in panel.elements]
    assert lines == names(both)[:1]
    assert parts["convergence"].notes == [f"{names(both)[1]}: no trial is likely within limits."]


def test_runs_of_which_none_has_an_incumbent(both):
    _, bad = both
    section = {s.name: s for s in comparison({"a": bad, "b": bad})}["convergence"]
    assert section.figures == []
    assert len(section.notes) == 2


def test_the_results_move_side_by_side(both, importable):
    """The object's position is its gain times the number of the step."""
    runs = dict(zip(names(both), both, strict=True))
    section = {s.name: s for s in comparison(runs)}["trajectories"]
    position, *_ = section.figures[0].panels
    assert position.title == "nominal context"
    lines = {line.name: line for line in position.elements}
    assert set(lines) == {"reference", *runs}
    for name, analysis in runs.items():
        gain = analysis.answer.parameters["gain"]
        np.testing.assert_allclose(lines[name].y, gain * np.arange(5))


def test_a_run_without_signals_is_named(both, monkeypatch):
    monkeypatch.setattr(sys, "path", [p for p in sys.path if "axis" not in p])
    monkeypatch.delitem(sys.modules, "report_objects", raising=False)
    elsewhere = [Analysis(replace(a.record, study=replace(a.study, folder=""))) for a in both]
    section = {s.name: s for s in comparison(dict(zip(names(both), elsewhere, strict=True)))}
    (first, second) = section["trajectories"].notes
    assert first.startswith(f"{names(both)[0]}: no trajectories: ")
    assert second.startswith(f"{names(both)[1]}: no trajectories: ")
    assert section["trajectories"].figures == []


@pytest.fixture
def report(capsys):
    """Function that runs the command; returns its exit code, output and errors."""
    return partial(call, report_command, capsys)


def test_the_command_writes_one_page_of_its_own(report, both, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    code, out, err = report(*(analysis.record.path for analysis in both))
    assert (code, out, err) == (0, "report: comparison.html\n", "")
    text = (tmp_path / "comparison.html").read_text(encoding="utf-8")
    assert "2 runs side by side" in text
    assert all(name in text for name in names(both))
    assert "<img" not in text


def test_each_run_that_cannot_be_read_is_one_line(report, tuned, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "empty").mkdir()
    code, out, err = report(tuned.path, "nowhere", "empty", tuned.path)
    assert (code, out) == (2, "")
    missing, empty, twice = err.splitlines()
    assert missing == "error: nowhere: no such run folder"
    assert empty == "error: empty: no run folder: it has no study.yaml"
    assert twice == f"error: {tuned.path}: named twice; expected different runs"
    assert not (tmp_path / "comparison.html").exists()
