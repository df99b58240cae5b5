"""Nodes that are not set back in the end: all results are written, and the exit code tells it."""

import shutil
from pathlib import Path

import pytest
from axis import node, write_study
from in_process import call

from bo_tuner.backends.inprocess import InProcessBackend
from bo_tuner.cli import replay, tune, validate
from bo_tuner.errors import BackendError

COMPLAINT = "servo could not be restored: servo does not answer"


@pytest.fixture(scope="module")
def made(tmp_path_factory, make_study):
    """Folder with a study's object."""
    found = tmp_path_factory.mktemp("made")
    write_study(found, make_study(nodes=node("left_axis")), peak='number("PEAK", 0.2)')
    return found


@pytest.fixture
def here(made, tmp_path, monkeypatch, capsys):
    """Function that runs a command, after which a node is not set back, in a folder of its own."""
    shutil.copytree(made, tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    close = InProcessBackend.close

    def refuse(backend):
        close(backend)
        raise BackendError(COMPLAINT)

    monkeypatch.setattr(InProcessBackend, "close", refuse)
    return lambda command, *arguments: call(command, capsys, *arguments)


@pytest.fixture
def run(here):
    """The folder of a whole run."""
    code, _, err = here(tune, "--backend", "inprocess", "--study", "axis.yaml")
    assert code == 1
    assert err.count(f"error: {COMPLAINT}\n") == 1
    return Path("runs/latest")


def test_a_run_has_its_results(run):
    files = {path.name for path in run.iterdir()}
    assert {"summary.json", "best.yaml", "trials.csv", "evaluations.csv", "report.html"} <= files


def test_a_certificate_is_written(run, here):
    code, out, err = here(validate, run)
    assert code == 1
    assert err.count(f"error: {COMPLAINT}\n") == 1
    assert "certificate: " in out
    assert (run / "certificates" / "0001.json").exists()


def test_no_other_parameter_set_is_tried(run, here, monkeypatch):
    monkeypatch.setenv("PEAK", "2")
    code, _, _ = here(validate, run, "--until-pass", "3")
    assert code == 1
    assert [path.name for path in (run / "certificates").glob("*.json")] == ["0001.json"]


def test_a_replay_is_shown(run, here):
    code, out, err = here(replay, run)
    assert code == 1
    assert err.count(f"error: {COMPLAINT}\n") == 1
    assert "recorded against replayed" in out
