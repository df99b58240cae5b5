"""A safe search as a user of ``tune`` sees it."""

import pytest
from axis import write_study
from in_process import call, complaint

from bo_tuner.cli import tune
from bo_tuner.evidence.facts import Said
from bo_tuner.evidence.run_verdict import run_verdict
from bo_tuner.evidence.verdict import State, Verdict
from bo_tuner.evidence.words.next_steps import next_steps
from bo_tuner.method_names import SAFE
from bo_tuner.methods.safe.stage_one import NO_SAFE_START
from bo_tuner.storage.record import read_run


@pytest.fixture
def study_file(tmp_path, make_study):
    return write_study(tmp_path, make_study(safe_search=True))


def test_without_a_safe_start_it_ends_with_what_would_help(
    tmp_path, study_file, capsys, monkeypatch, handlers
):
    """The peak is limited to 1; nothing more is run, neither now nor when it is resumed."""
    monkeypatch.setenv("PEAK", "2")
    monkeypatch.chdir(tmp_path)
    options = ("--backend", "inprocess", "--study", study_file, "--quiet")
    code, _, err = call(tune, capsys, *options)
    record = read_run(tmp_path / "runs" / "latest")
    assert (code, record.algorithm, len(record.evaluations)) == (3, SAFE, 1)
    assert NO_SAFE_START in " ".join(err.split())
    (reason,) = run_verdict(record).reasons
    assert reason.text == f"{NO_SAFE_START[0].upper()}{NO_SAFE_START[1:]}"
    # There is nothing to validate, and to resume it would end there again.
    commands = [step.command for step in next_steps(run_verdict(record), "runs/a")]
    assert commands == ["tune --from runs/a --start FILE"]
    code, _, _ = call(tune, capsys, "--resume", "latest", "--quiet")
    assert (code, len(read_run(tmp_path / "runs" / "latest").evaluations)) == (3, 1)


@pytest.mark.parametrize("state", [State.VALIDATED, State.INFEASIBLE, State.REFUSED])
def test_a_search_that_stood_still_is_not_to_be_resumed(state):
    """Its answer is settled all the same; more trials need a study that permits more."""
    verdict = Verdict(state=state, trial=2, reasons=(Said("why"),), standstill=True)
    commands = [step.command for step in next_steps(verdict, "runs/a")]
    assert "tune --from runs/a --study FILE" in commands
    assert not any(command.startswith("tune --resume") for command in commands)


def test_a_study_asks_for_it_by_itself(tmp_path, make_study, capsys, monkeypatch, handlers):
    study = write_study(tmp_path, make_study(safe_search={"travel": 0.2}))
    monkeypatch.chdir(tmp_path)
    code, _, _ = call(tune, capsys, "--backend", "inprocess", "--study", study, "--quiet")
    record = read_run(tmp_path / "runs" / "latest")
    assert (code, record.algorithm) == (0, SAFE)
    gains = [trial.parameters["gain"] for trial in record.trials]
    assert gains[0] == 0.5
    assert all(
        min(abs(gain - other) for other in gains[:k]) <= 0.2 + 1e-9
        for k, gain in enumerate(gains[1:], 1)
    )


def test_another_algorithm_is_refused_beside_it(study_file, capsys):
    options = ("--backend", "inprocess", "--study", study_file, "--algorithm", "V")
    said = "--algorithm: V is no safe search, and the study has `safe_search`; expected safe"
    assert said in complaint(tune, capsys, *options)


def test_without_a_limit_it_is_refused(tmp_path, make_study, capsys, monkeypatch):
    study = write_study(tmp_path, make_study(constraints={}, safe_search=True))
    monkeypatch.chdir(tmp_path)
    line = complaint(tune, capsys, "--backend", "inprocess", "--study", study)
    assert line.startswith("error: safe_search: safe needs a limit to keep, and the study has none")
