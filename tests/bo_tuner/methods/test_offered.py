"""The method of docs/python.md, of another package by its entry point, and without it."""

import sys
from pathlib import Path

import pytest
import yaml
from offering import offer
from report_runs import axis_study, run_study

from bo_tuner.cli import report, tune, validate
from bo_tuner.errors import MethodError
from bo_tuner.interruption import Interruption
from bo_tuner.method_names import BOUNDARY, titles
from bo_tuner.methods.registry import METHODS
from bo_tuner.storage.record import read_run

PAGE = Path(__file__).parents[3] / "docs" / "python.md"
MODULE = (
    PAGE.read_text().split("## A method of your own")[1].split("```python\n")[1].split("```")[0]
)


@pytest.fixture
def line(tmp_path, monkeypatch):
    """The folder of a package with the method `line`, on the path."""
    folder = tmp_path / "site"
    offer(folder, "line_methods", line="line_of_test:LINE", boundary="line_of_test:LINE")
    (folder / "line_of_test.py").write_text(MODULE, encoding="utf-8")
    monkeypatch.syspath_prepend(folder)
    yield folder
    sys.modules.pop("line_of_test", None)


def test_help_has_its_title_and_does_not_load_it(line, capsys):
    with pytest.raises(SystemExit) as stop:
        tune.run(["--help"], Interruption())
    assert stop.value.code == 0
    assert "line: line of line_methods" in " ".join(capsys.readouterr().out.split())
    assert "line" in METHODS
    assert "line_of_test" not in sys.modules
    # Ours cannot be replaced.
    assert "line_methods" not in titles()[BOUNDARY]
    assert type(METHODS[BOUNDARY]).__name__ == "Boundary"


def test_it_tunes_and_without_its_package_the_run_names_it(line, tmp_path, monkeypatch, capsys):
    budget = {"trials": 4, "initial_trials": 1, "validation_draws": 4}
    text = yaml.safe_dump(axis_study(budget=budget))
    path = run_study(tmp_path, text, "--algorithm", "line")
    record = read_run(path)
    assert [t.parameters["gain"] for t in record.trials] == pytest.approx([0, 1 / 3, 2 / 3, 0])
    assert record.provenance["line_methods"] == "1.0"
    assert report.run([str(path)], Interruption()) == 0

    monkeypatch.setattr(sys, "path", [entry for entry in sys.path if entry != str(line)])
    capsys.readouterr()
    for command, *options in ((tune, "--resume"), (report,), (validate,)):
        assert command.run([*options, str(path)], Interruption()) == 2
        (said,) = capsys.readouterr().err.splitlines()
        assert said.endswith(
            "its algorithm 'line' is of the package 'line_methods', which is not installed"
        )


@pytest.mark.parametrize(
    ("value", "problem"),
    [
        ("no_such_module_here:LINE", "cannot be loaded: ModuleNotFoundError: No module named"),
        ("line_of_test:OnALine", "line_of_test:OnALine: expected a Method, found"),
    ],
)
def test_what_cannot_be_loaded_is_one_line(line, tmp_path, monkeypatch, value, problem):
    offer(tmp_path / "other", "other_methods", other=value)
    monkeypatch.syspath_prepend(tmp_path / "other")
    with pytest.raises(MethodError) as caught:
        METHODS["other"]
    assert str(caught.value).startswith("the algorithm other of the package other_methods")
    assert problem in str(caught.value)
    assert "\n" not in str(caught.value)
