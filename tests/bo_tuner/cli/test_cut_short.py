"""A study whose runs are cut short, from the command line to the report."""

import csv
import io
import re
from contextlib import redirect_stderr

import pytest
import yaml
from cut_short_runs import GROWS, short_study
from in_process import Uninterrupted, call, complaint

from bo_tuner.cli import replay, report, tune
from bo_tuner.evidence.trial_row import TrialOutcome
from bo_tuner.report.analysis import Analysis
from bo_tuner.report.trial_page import trial_sections
from bo_tuner.storage.record import read_run
from bo_tuner.study.study_file import study_to_mapping
from bo_tuner.trials import EvaluationState, TrialState

OBJECTS = """\
class Axis:
    def set_parameters(self, values):
        self.values = dict(values)

    def end_beyond(self, values):
        self.bounds = dict(values)

    def evaluate(self):
        gain, load, seed = (self.values[name] for name in ("gain", "load", "seed"))
        noise = 0.01 * (seed % 7 - 3) / 3.0
        error, peak = 1.2 - gain + 0.1 * load + noise, gain * load * (1.0 + noise)
        for k in range(1, 101):
            so_far = {"error": error * k / 100.0, "peak": peak * k / 100.0}
            if k < 100 and any(so_far[name] > most for name, most in self.bounds.items()):
                return {"status": "cut short", "after": 0.1 * k} | so_far
        return {"status": "ok", "reason": "", "error": error, "peak": peak}
"""
SHOWN = r"cut short after \d\.\d+ s: (error|peak) at least \d\.\d+ mm"


@pytest.fixture(scope="module")
def study_file(tmp_path_factory):
    """The study file, beside its object."""
    folder = tmp_path_factory.mktemp("cut_short")
    (folder / "ending_axis.py").write_text(OBJECTS)
    metrics = {"error": GROWS | {"unit": "mm"}, "peak": GROWS | {"unit": "mm"}}
    content = study_to_mapping(short_study(metrics=metrics))
    content["nodes"]["axis"]["object"] = "ending_axis:Axis"
    (folder / "study.yaml").write_text(yaml.safe_dump(content))
    return folder / "study.yaml"


@pytest.fixture(scope="module")
def made(study_file):
    """What the command has shown, and the record."""
    shown = io.StringIO()
    with redirect_stderr(shown):
        folder = study_file.parent / "runs"
        options = ["--study", str(study_file), "--output", str(folder), "--backend", "inprocess"]
        tune.run(options, Uninterrupted())
    return shown.getvalue(), read_run(folder / "latest")


def test_a_trial_says_what_is_known_and_is_none_that_failed(made):
    shown, record = made
    cut = [trial for trial in record.trials if trial.state is TrialState.CUT_SHORT]
    assert cut
    lines = [line for line in shown.splitlines() if re.search(SHOWN, line)]
    assert len(lines) == len(cut)
    assert "FAILED" not in shown


def test_files_have_it(made):
    record = made[1]
    with (record.path / "evaluations.csv").open() as file:
        rows = [row for row in csv.DictReader(file) if row["state"] == "cut short"]
    assert rows
    for row in rows:
        assert re.fullmatch(SHOWN, row["reason"])
        assert row["metrics.error"] == ""
        assert float(row["notes.at_least.error"]) > 0.0
        assert 0.0 < float(row["notes.cut_after"]) < 10.0


def test_the_report_shows_it_beside_those_that_violate_a_limit(made, capsys):
    record = made[1]
    analysis = Analysis(record)
    (trial, *_) = (t for t in record.trials if t.state is TrialState.CUT_SHORT)
    assert analysis.outcome(trial) == TrialOutcome.CUT_SHORT
    text = repr([*trial_sections(analysis, trial)])
    assert re.search(SHOWN, text)
    code, _, err = call(report, capsys, record.path)
    assert code == 0, err
    page = (record.path / "report.html").read_text()
    assert re.search(SHOWN, page)
    assert "No test run failed" in page


def test_its_replay_is_whole(made, capsys):
    record = made[1]
    (evaluation, *_) = (
        e for e in record.evaluations if e.outcome.state is EvaluationState.CUT_SHORT
    )
    code, out, _ = call(replay, capsys, record.path, "--trial", evaluation.trial, "--trust")
    assert code == 0, out
    assert "the replay is whole, and its metrics may be larger" in out
    assert out.count("at least as large") == 2


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        (["--backend", "ros"], "budget.cut_short: nothing ends a run of a node that a service"),
        (["--algorithm", "V"], "--algorithm: V needs whole runs, and the study has `budget.cut"),
    ],
)
def test_what_needs_whole_runs_is_refused(study_file, capsys, options, expected):
    backend = [] if "--backend" in options else ["--backend", "inprocess"]
    line = complaint(tune, capsys, "--study", study_file, *backend, *options)
    assert expected in line
