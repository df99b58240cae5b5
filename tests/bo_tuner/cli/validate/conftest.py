"""A run of a small object, and `validate` on a copy of it in this process."""

import shutil
from functools import partial
from pathlib import Path

import pytest
from axis import node, write_study
from commands import run
from in_process import call, complaint
from validated_run import CHANCE

from bo_tuner.cli import validate as validate_command


@pytest.fixture(scope="module")
def runs(tmp_path_factory, make_study):
    """Folder with a run, which is copied for each test, and with its object."""
    found = tmp_path_factory.mktemp("runs")
    noise = "(self.seed % 997) / 997"
    write_study(
        found,
        make_study(nodes=node("validated_axis"), constraints=CHANCE),
        peak=f'number("PEAK", 0.2) + 0.1 * self.load * {noise}',
    )
    code, _, err = run("tune", "--backend", "inprocess", "--study", "axis.yaml", folder=found)
    assert code == 0, err
    return found


@pytest.fixture
def folder(runs, tmp_path):
    """A copy of the run."""
    return Path(shutil.copytree((runs / "runs" / "latest").resolve(), tmp_path / "run"))


@pytest.fixture
def here(runs, monkeypatch, capsys):
    """Function that runs the command in this process; returns code, out and err."""
    monkeypatch.syspath_prepend(runs)
    return partial(call, validate_command, capsys)


@pytest.fixture
def refusal(runs, monkeypatch, capsys):
    """Function that runs the command and returns its one line of complaint."""
    monkeypatch.syspath_prepend(runs)
    return partial(complaint, validate_command, capsys)
