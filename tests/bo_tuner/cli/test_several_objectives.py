"""A study with two objectives by the commands: the front is found, shown, and chosen from."""

import dataclasses
import json
import re
import shutil
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from axis import node, write_study
from commands import run

from bo_tuner.evidence.run_verdict import certified, run_verdict
from bo_tuner.evidence.verdict import PASS
from bo_tuner.evidence.words.verdict import as_mapping, sentences
from bo_tuner.report.analysis import Analysis
from bo_tuner.report.page import chapters
from bo_tuner.report.sections.answer import answer
from bo_tuner.report.sections.what_if import what_if
from bo_tuner.report.trial_page import trial_sections
from bo_tuner.storage.record import read_run
from bo_tuner.tuning.summary import with_summary

CHANCE = {"peak": {"kind": "chance", "metric": "peak", "upper": 1.0, "probability": 0.9}}
AXIS = {"node": "axis"}


TUNE = ("tune", "--backend", "inprocess", "--study", "axis.yaml")


@pytest.fixture(scope="module")
def runs(tmp_path_factory, make_study):
    """A run of a study of two objectives, which conflict."""
    folder = tmp_path_factory.mktemp("runs")
    study = make_study(
        nodes=node("front_axis"),
        constraints=CHANCE,
        further_objectives=[{"metric": "peak"}],
    ).replace(trials=10, initial_trials=5)
    # Both errors are smallest at different gains.
    write_study(
        folder,
        study,
        error="(self.gain - 0.3) ** 2 + 0.01 * self.load",
        peak="(self.gain - 0.8) ** 2 + 0.001 * self.load",
    )
    code, out, err = run(*TUNE, folder=folder)
    assert code == 0, err
    latest = (folder / "runs" / "latest").resolve()
    front = json.loads((latest / "summary.json").read_text())["front"]
    return SimpleNamespace(folder=folder, latest=latest, out=out, front=front)


def test_the_front_is_printed_with_a_mark_on_the_result(runs):
    assert len(runs.front) > 2
    result = json.loads((runs.latest / "summary.json").read_text())["trial"]
    lines = runs.out.splitlines()
    (head,) = [k for k, line in enumerate(lines) if line.startswith("Pareto front")]
    shown = [line.split() for line in lines[head:] if re.match(r" *\d+ .*±", line)]
    assert [int(words[0]) for words in shown] == [point["trial"] for point in runs.front]
    assert [int(words[0]) for words in shown if words[-1] == "result"] == [result]
    assert "the tuned parameter set is the compromise" in runs.out


def test_the_front_goes_from_one_optimum_to_the_other(runs):
    trials = read_run(runs.latest).trials
    gains = [trials[point["trial"]].parameters["gain"] for point in runs.front]
    assert gains == sorted(gains)
    assert gains[0] < 0.4
    assert gains[-1] > 0.7


def test_the_record_alone_gives_the_same_front(runs, tmp_path):
    copy = Path(shutil.copytree(runs.latest, tmp_path / "run"))
    (copy / "summary.json").unlink()
    assert with_summary(read_run(copy), str).summary["front"] == runs.front


def test_the_report_shows_the_front_instead_of_the_trade_off(runs):
    from report_runs import sections

    record = with_summary(read_run(runs.latest), str)
    found = {section.name: section for section in sections(Analysis(record))}
    assert "trade-off" not in found
    for choice, point in zip(found["front"].choices, runs.front, strict=True):
        value, error = re.search(r"peak ([\d.]+) ± ([\d.e-]+)", choice.title).groups()
        mean = point["means"]["peak"]
        assert float(value) == pytest.approx(mean["value"], rel=1e-3)
        assert float(error) == pytest.approx(mean["error"], rel=0.05)
    assert "The result is the compromise" in found["front"].lead
    going_on = sections(Analysis(dataclasses.replace(record, summary=None)))
    (of_run,) = [section for section in going_on if section.name == "front"]
    assert "The result" not in of_run.lead
    assert all(name in found["all-trials"].tables[0].header for name in ("mean error", "mean peak"))


def test_each_point_of_the_front_can_be_chosen(runs):
    """By its commands, with its parameters beside those of the result."""
    from report_runs import sections

    analysis = Analysis(with_summary(read_run(runs.latest), str))
    (front,) = [section for section in sections(analysis) if section.name == "front"]
    result = analysis.record.summary["trial"]
    assert [choice.trial for choice in front.choices] == [point["trial"] for point in runs.front]
    for choice in front.choices:
        number, run = choice.trial, str(runs.latest)
        commands = [step.command for step in choice.steps]
        both = [f"{name} {run} --trial {number}" for name in ("validate", "apply")]
        assert commands == ([] if number == result else both)
        (row,) = choice.values.rows
        gain = analysis.trials[number].parameters["gain"]
        assert float(row[1]) == pytest.approx(gain, rel=1e-3)
        name = f"Trial {number}, the result" if number == result else f"Trial {number}"
        assert choice.title.startswith(f"{name}: error ")
        # The objects of this study have no signals.
        assert choice.figure is None


def test_what_is_predicted_of_each_objective_is_told(runs):
    """Along the sliders, where each has a model: the cost of the compromise has no unit."""
    analysis = Analysis(with_summary(read_run(runs.latest), str))
    sliders = what_if(analysis)
    assert [title for title, _ in sliders.rows[:2]] == ["mean error", "mean peak"]
    (along,) = sliders.along
    gains = np.array(sliders.sliders[0].values)
    told = np.array([[float(cell.split()[0]) for cell in each.cells[:2]] for each in along])
    # Each is smallest at its own optimum.
    best = gains[told.argmin(axis=0)]
    assert best == pytest.approx([0.3, 0.8], abs=0.15)


def test_what_the_models_predict_is_called_the_cost_of_the_compromise(runs):
    """It is that of no objective, and has none's unit."""
    from report_runs import sections

    analysis = Analysis(with_summary(read_run(runs.latest), str))
    drawn = {figure.name: figure for item in sections(analysis) for figure in item.figures}
    (panel, *_) = drawn["slices"].panels
    assert panel.y.title == "cost of the compromise"
    assert "trials nearby" not in [getattr(element, "name", "") for element in panel.elements]
    (line,) = [e for e in panel.elements if getattr(e, "name", "") == "predicted mean"]
    gains = np.array(line.x)[:, None]
    bounds = analysis.study.parameters["gain"].bounds
    cube = (gains - bounds[0]) / (bounds[1] - bounds[0])
    np.testing.assert_allclose(line.y, analysis.models.objective.predict_mean(cube))


def test_the_page_of_a_trial_has_the_means_of_all_objectives(runs):
    analysis = Analysis(with_summary(read_run(runs.latest), str))
    point = runs.front[0]
    (trial,) = [trial for trial in analysis.trials if trial.number == point["trial"]]
    summary, *_ = trial_sections(analysis, trial)
    for name, mean in point["means"].items():
        assert f"Mean {name} " in summary.lead
        # The same as on the front.
        assert f"{mean['value']:.4g} (model)" in summary.lead


def test_any_point_can_be_certified(runs):
    other = runs.front[0]["trial"]
    folder = runs.folder
    code, _, err = run("validate", "runs/latest", "--trial", other, "--runs", 80, folder=folder)
    assert code == 0, err
    code, _, err = run("apply", "runs/latest", "--trial", 99, "--yes", folder=folder)
    assert (code, "no trial 99" in err) == (2, True)


def test_a_certificate_still_tells_how_the_result_was_chosen(runs, tmp_path):
    shutil.copytree(runs.latest, tmp_path / "run")
    shutil.copy(runs.folder / "front_axis.py", tmp_path)
    result = json.loads((tmp_path / "run" / "summary.json").read_text())["trial"]
    other = next(point["trial"] for point in runs.front if point["trial"] != result)

    def validate(trial):
        arguments = ("validate", "run", "--trial", trial, "--runs", "80")
        code, _, err = run(*arguments, folder=tmp_path)
        assert code == 0, err

    validate(other)
    record = read_run(tmp_path / "run")
    path = tmp_path / "run" / "certificates" / "0001.json"
    of_other = certified(record, record.trials[other], path)
    assert not any("the compromise" in sentence for sentence in sentences(of_other))
    validate(result)
    verdict = run_verdict(read_run(tmp_path / "run"))
    assert verdict.certificate == PASS
    assert any(
        "the tuned parameter set is the compromise" in sentence for sentence in sentences(verdict)
    )
    bundle, summary = (
        json.loads((tmp_path / "run" / name).read_text())["verdict"]
        for name in ("deploy/provenance.json", "summary.json")
    )
    assert bundle == summary == as_mapping(verdict)


def test_what_needs_one_objective_is_refused(runs):
    code, out, err = run(*TUNE, "--stop-early", folder=runs.folder)
    assert (code, out) == (2, "")
    assert "--stop-early: expected a study with one objective; leave it out" in err


@pytest.mark.parametrize(
    ("algorithm", "remark"),
    [
        ("boundary", "those that the models of all test runs predict"),
        ("IV", "those of their own test runs"),
    ],
)
def test_the_report_says_whose_means_the_front_has(runs, tmp_path, algorithm, remark):
    record = read_run(runs.latest)
    if algorithm != "boundary":
        shutil.copy(runs.folder / "front_axis.py", tmp_path)
        shutil.copy(runs.folder / "axis.yaml", tmp_path)
        code, _, err = run(*TUNE, "--algorithm", algorithm, folder=tmp_path)
        assert code == 0, err
        record = read_run(tmp_path / "runs" / "latest")
    assert record.algorithm == algorithm
    made = chapters(Analysis(with_summary(record, str)))
    (front,) = [s for part in made for s in part.sections if s.name == "front"]
    assert remark in front.notes[0]
    modelled = algorithm == "boundary"
    figure = answer(Analysis(with_summary(record, str))).figure
    assert figure.name == "front"
    assert ("by the models of all test runs" in figure.caption) is modelled
