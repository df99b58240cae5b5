"""One run with a certificate: each number is the same on every screen and in every file."""

import csv
import io
import json
from dataclasses import replace

import numpy as np
import pytest
from rich.console import Console

import bo_tuner as bt
from bo_tuner.evidence.run_verdict import run_verdict
from bo_tuner.evidence.trial_row import TrialOutcome
from bo_tuner.evidence.words.certificate_table import certificate_lines, certificate_rows
from bo_tuner.evidence.words.quantities import basis, gain
from bo_tuner.evidence.words.terminal import print_verdict
from bo_tuner.figures.figure import Points
from bo_tuner.report.analysis import Analysis
from bo_tuner.report.comparison import comparison, in_a_row
from bo_tuner.report.sections.answer import answer
from bo_tuner.report.sections.front import front_figure
from bo_tuner.report.sections.trade_off import trade_off
from bo_tuner.report.trial_page import trial_sections
from bo_tuner.storage.record import read_run
from bo_tuner.text import shown
from bo_tuner.tuning.front import pareto_front
from bo_tuner.web.runs import Runs

BUDGET = bt.Budget(
    trials=6, initial_trials=4, drawn_contexts=2, search_evaluations=2, validation_draws=25
)


def response(parameters, context, seed):
    """The load explains most of the scatter of the error, so an adjusted mean is another number."""
    noise = 0.02 * np.random.default_rng(seed).standard_normal()
    error = 1.0 + context["load"] * (1.0 + (parameters["gain"] - 0.3) ** 2) + noise
    return {"error": error, "effort": 1.0 - parameters["gain"] + noise, "peak": 0.3 + noise}


def make_study(**sections):
    return bt.Study(
        **{
            "name": "axis",
            "parameters": {"gain": bt.Double(0.0, 1.0, default=0.9)},
            "contexts": {"load": bt.Uniform(bounds=(1.0, 2.0))},
            "metrics": ["error", "effort", "peak"],
            "objective": "error",
            "constraints": {
                "peak": bt.WorstCase("peak", upper=1.0, probability=0.8),
            },
            "budget": BUDGET,
        }
        | sections
    )


@pytest.fixture(scope="module")
def tuned_only(tmp_path_factory):
    folder = tmp_path_factory.mktemp("values") / "run"
    return make_study().optimize(response, folder=folder, progress=False)


@pytest.fixture(scope="module", params=["validated", "certified"])
def result(request, tuned_only):
    if request.param == "certified":
        tuned_only.certify(response, runs=60, progress=False)
    return bt.load(tuned_only.folder)


def in_terminal(record, verdict):
    out = Console(file=io.StringIO(), width=300)
    print_verdict(out, record.study, verdict, record.result.parameters)
    (row,) = [s for s in out.file.getvalue().splitlines() if s.startswith("mean error ")]
    return row.split()[2:4]


def test_every_screen_and_file_has_the_same_number(result):
    record = read_run(result.folder)
    verdict, analysis = run_verdict(record), Analysis(record)
    (error,) = [q for q in verdict.quantities if q.objective]
    default, tuned = (shown(estimate.value) for estimate in error.estimates)
    kind = "validation, adjusted for contexts"
    assert basis(error).startswith(kind)
    # Not the mean of the draws as they are.
    plain = np.mean(verdict.observed[0].values("error"))
    assert abs(plain - error.default) > 1e-3
    assert in_terminal(record, verdict) == [default, tuned]

    screen = answer(analysis)
    (row,) = [row for row in screen.rows if row.detail == "mean, objective"]
    assert (row.title, row.default, row.tuned) == ("error", default, tuned)
    assert any(basis(error) in remark for remark in screen.remarks)

    row = in_a_row(analysis)
    assert row["objective"].startswith(f"mean error {default} → {tuned}")
    assert row["objective"].endswith(", validation")
    numbers = {part.name: part for part in comparison({"a": analysis, "b": analysis})}["numbers"]
    (row,) = [row for row in numbers.tables[0].rows if row[0] == "mean error"]
    assert row[1].startswith(f"{tuned} ({default})")
    (row,) = csv.DictReader(io.StringIO(Runs(result.folder.parent).table()))
    assert float(row["mean error"]) == error.tuned
    assert float(row["default: mean error"]) == error.default

    for trial in analysis.trials:
        lead = trial_sections(analysis, trial)[0].lead
        model = f"{shown(analysis.estimate(trial, 'error').value)} (model)"
        assert model in lead
        if trial.number == verdict.trial:
            assert f"Mean error {tuned} ({kind}), {model}." in lead
        elif dict(trial.parameters) == dict(analysis.defaults):
            assert f"Mean error {default} ({kind}), {model}." in lead

    summary = json.loads((result.folder / "summary.json").read_text())
    (of_file,) = [q for q in summary["verdict"]["quantities"] if q["objective"]]
    assert (of_file["default"], of_file["tuned"]) == (error.default, error.tuned)
    assert [of_file["estimates"][side]["value"] for side in ("default", "tuned")] == [
        error.default, error.tuned,
    ]  # fmt: skip
    assert not {"objective", "deviation"} & summary["tuned"].keys()
    (of_api,) = [q for q in result.verdict.quantities if q.objective]
    assert of_api == error
    assert f"mean error {default} → {tuned}" in result._repr_html_()


def test_a_certificate_repeats_no_number_of_the_verdict(tuned_only):
    certificate = tuned_only.certificate or tuned_only.certify(response, runs=60, progress=False)
    record = read_run(tuned_only.folder)
    verdict = run_verdict(record)
    (error,) = [q for q in verdict.quantities if q.objective]
    assert not any("mean error" in row.label for row in certificate_rows(record.study, certificate))
    lines = certificate_lines(verdict, record.study, certificate, 9)
    assert f"{gain(error)}; {basis(error)}" in lines
    assert basis(error).startswith("validation, adjusted for contexts; in the 25 test runs")
    # Its own draws are other evidence, which its file has by the same rule.
    own = certificate.tuned.objective
    assert own.kind == "certificate, adjusted for contexts"
    assert own == verdict.observed[1].estimate("error", record.study.context_space())
    assert own.value != error.tuned
    (extreme,) = [q for q in verdict.quantities if q.constraint == "peak"]
    assert certificate.tuned.constraints[0].worst[0].mean.value == extreme.tuned


def stars(panel):
    """The mark of the result, and where its trial stands among the others."""
    points = [e for e in panel.elements if isinstance(e, Points)]
    (star,) = [e for e in points if e.name == "tuned"]
    (number,) = star.trials
    own = [
        (x, y)
        for e in points
        for x, y, trial in zip(e.x, e.y, e.trials or (), strict=False)
        if trial == number
    ]
    return (star.x[0], star.y[0]), own


def test_the_star_stands_on_its_own_circle(tuned_only, tmp_path, monkeypatch):
    analysis = Analysis(read_run(tuned_only.folder))
    (figure,) = trade_off(analysis).figures
    star, own = stars(figure.panels[0])
    assert set(own) == {star}
    assert star[1] == analysis.estimate(analysis.answer, "error").value

    study = make_study(further_objectives=[{"metric": "effort"}])
    several = study.optimize(response, folder=tmp_path / "run", progress=False)
    analysis = Analysis(read_run(several.folder))
    star, own = stars(front_figure(analysis).panels[0])
    assert len(own) >= 3
    assert set(own) == {star}

    # One far off, over a limit, is at the edge and leaves the others their room.
    known = pareto_front(analysis.study, analysis.ranked)
    far = known[-1].trial
    outcome, estimate = Analysis.outcome, Analysis.estimate

    def outlying(self, trial, name):
        found = estimate(self, trial, name)
        return replace(found, value=1e6) if trial.number == far else found

    def over(self, trial):
        return TrialOutcome.VIOLATES if trial.number == far else outcome(self, trial)

    monkeypatch.setattr(Analysis, "estimate", outlying)
    monkeypatch.setattr(Analysis, "outcome", over)
    monkeypatch.setattr("bo_tuner.report.sections.front.pareto_front", lambda *_: known[:-1])
    points = [e for e in front_figure(analysis).panels[0].elements if isinstance(e, Points)]
    (off,) = [e for e in points if e.name == "off the scale"]
    assert list(off.trials) == [far]
    assert "1e+06" in off.hover[0]
    assert max(max(e.y) for e in points) == off.y[0] < 1e3
