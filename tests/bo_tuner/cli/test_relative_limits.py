"""A study with a limit relative to the default, from the file to the certificate, in process."""

import json
import signal

import pytest
from axis import node
from command_runs import Runs
from commands import run
from in_process import call

from bo_tuner.cli import replay, validate
from bo_tuner.storage.record import read_run
from bo_tuner.study import strict_yaml
from bo_tuner.study.study_file import study_to_mapping

CALM = {"kind": "chance", "metric": "peak", "upper": "default + 0.05", "probability": 0.9}
BUDGET = {
    "trials": 10, "initial_trials": 5, "drawn_contexts": 2, "search_evaluations": 0,
    "validation_draws": 25,
}  # fmt: skip
# Context and noise say much more of a peak than the gain does, but nothing of a difference.
DRAW = "self.load + 0.1 * (self.seed % 7)"
DEFAULT = 0.5
LIMIT = DEFAULT + 0.05


@pytest.fixture(scope="module")
def runs(tmp_path_factory, make_study):
    study = make_study(
        nodes=node("relative_axis"), constraints={"calm": CALM}, budget=BUDGET, start=["default"]
    )
    return Runs(
        tmp_path_factory.mktemp("runs"),
        study,
        error="(self.gain - 1) ** 2",
        peak=f"self.gain + {DRAW}",
        fails="False",
    )


@pytest.fixture(scope="module")
def whole(runs):
    code, _, err = runs.begin("whole")
    assert code == 0, err
    return "whole"


def test_the_result_is_at_the_limit_and_all_is_on_record(runs, whole):
    record = read_run(runs.latest(whole))
    summary = json.loads((runs.latest(whole) / "summary.json").read_text())
    # The objective is the better the larger the gain is.
    assert DEFAULT < summary["tuned"]["parameters"]["gain"] <= LIMIT
    for evaluation in record.evaluations:
        load, seed = evaluation.context["load"], evaluation.seed
        default = DEFAULT + load + 0.1 * (seed % 7)
        assert evaluation.outcome.notes.default["peak"] == default
        metrics = evaluation.outcome.metrics
        assert metrics["peak_minus_default"] == metrics["peak"] - default
    # The evaluations that count are those on record; a draw has one run of the default.
    draws = [(e.context["load"], e.seed) for e in record.evaluations]
    own = [e.parameters["gain"] == DEFAULT for e in record.evaluations]
    known = {draw for draw, is_default in zip(draws, own, strict=True) if is_default}
    assert len(known) > BUDGET["validation_draws"]
    assert runs.evaluations(whole) == len(draws) + len(set(draws) - known)


@pytest.mark.parametrize("kill", [2, 11, 30])
def test_after_a_kill_the_run_is_the_same_to_the_last_bit(runs, whole, kill):
    name = f"killed-{kill}"
    assert runs.begin(name, kill=kill)[0] == -signal.SIGKILL
    code, _, err = runs.resume(name)
    assert code == 0, err
    assert runs.results(name) == runs.results(whole)


def test_the_report_and_the_tables_have_the_metric(runs, whole):
    assert "peak_minus_default" in (runs.latest(whole) / "report.html").read_text()
    table = (runs.latest(whole) / "evaluations.csv").read_text()
    assert "peak_minus_default" in table.partition("\n")[0]


def test_a_certificate_and_a_replay(runs, whole, monkeypatch, capsys):
    monkeypatch.chdir(runs.folder)
    monkeypatch.syspath_prepend(runs.folder)
    runs.copy(whole, "certified")
    folder = runs.latest("certified")
    code, out, err = call(validate, capsys, folder)
    assert (code, out.partition(":")[0]) == (0, "PASS"), err
    code, out, err = call(replay, capsys, folder)
    assert code == 0, err
    assert "confirmed" in out
    above = max(read_run(folder).trials, key=lambda trial: trial.parameters["gain"])
    assert above.parameters["gain"] > LIMIT
    code, out, err = call(validate, capsys, folder, "--trial", above.number)
    assert (code, out.partition(":")[0]) == (3, "FAIL"), err


def test_another_multiple_takes_the_data(runs, whole):
    """What the default has is on record, so that no trial is lost."""
    mapping = study_to_mapping(read_run(runs.latest(whole)).study)
    del mapping["metrics"]["peak_minus_default"]
    mapping["constraints"] = {"calm": CALM | {"upper": "1.1 * default"}}
    (runs.folder / "wider.yaml").write_text(strict_yaml.dump(mapping))
    code, out, err = run(
        "tune", "--from", runs.latest(whole), "--study", "wider.yaml", "--backend", "inprocess",
        "--trials", "13", "--output", "wider", folder=runs.folder,
    )  # fmt: skip
    assert code in (0, 3), err
    assert "begins with 10 of 10 trials" in out + err
    begun = read_run(runs.folder / "wider" / "latest").trials[:10]
    for trial in begun:
        for evaluation in trial.evaluations:
            default = DEFAULT + evaluation.context["load"] + 0.1 * (evaluation.seed % 7)
            metrics = evaluation.outcome.metrics
            assert metrics["peak_minus_1.1_default"] == metrics["peak"] - 1.1 * default
