"""A command whose nodes or guard are gone says so: message, exit code, notification, JSON, hint."""

import json
import shutil
from pathlib import Path

import pytest
from axis import node, write_study
from commands import run
from in_process import call

from bo_tuner.backends.inprocess import InProcessBackend
from bo_tuner.cli import check, replay, try_, tune, validate
from bo_tuner.errors import BackendError
from bo_tuner.metrics.recording import NOTHING_RECORDED

GONE = "the guard of the nodes has ended: it has ended with -9"
NOTIFY = ("--notify", 'echo "$BO_TUNER_EXIT_CODE|$BO_TUNER_HEADLINE" > told')
NEW = ("--backend", "inprocess", "--study", "axis.yaml")
CERTIFICATE = "runs/latest/certificates/0001.json"

COMMANDS = {
    "tune": (tune, *NEW, *NOTIFY),
    "tune as JSON": (tune, *NEW, "--json-lines", *NOTIFY),
    "validate": (validate, "runs/latest", *NOTIFY),
    "drift": (validate, "--against", CERTIFICATE, *NOTIFY),
    "replay": (replay, "runs/latest"),
    "try": (try_, "axis.yaml", "--backend", "inprocess"),
    "check": (check, "axis.yaml", "--no-attach"),
}
CASES = [
    (name, before)
    for name in COMMANDS
    for before in ((0,) if name in ("replay", "try") else (0, 1) if name == "check" else (0, 1, 4))
]


class NodesOfACheck(InProcessBackend):
    """In place of nodes."""

    recording = NOTHING_RECORDED

    def __init__(self, study, folder, **_):
        super().__init__(study)

    def start_anew(self):
        pass


@pytest.fixture(scope="module")
def made(tmp_path_factory, make_study):
    """Folder with a study, a whole run of it, and a certificate."""
    folder = tmp_path_factory.mktemp("made")
    write_study(folder, make_study(nodes=node("ended_axis")), peak='number("PEAK", 0.2)')
    for command in (("tune", *NEW, "--quiet"), ("validate", "runs/latest")):
        code, _, err = run(*command, folder=folder)
        assert code == 0, err
    return folder


@pytest.fixture
def here(made, tmp_path, monkeypatch, capsys):
    """Function that runs a command in a folder of its own, in which the guard can be gone."""
    shutil.copytree(made, tmp_path, dirs_exist_ok=True, symlinks=True)
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(check, "RosBackend", NodesOfACheck)
    return lambda command, *arguments: call(command, capsys, *arguments)


@pytest.fixture
def gone_after(monkeypatch):
    """Function that lets the guard be gone after some runs."""
    outcome = InProcessBackend.outcome

    def let(runs):
        left = iter(range(runs))

        def ended(backend, planned):
            if next(left, None) is None:
                raise BackendError(GONE)
            return outcome(backend, planned)

        monkeypatch.setattr(InProcessBackend, "outcome", ended)

    return let


@pytest.mark.parametrize(("name", "runs"), CASES)
def test_a_guard_that_ends_in_a_run_is_no_bad_input(name, runs, here, gone_after):
    command, *arguments = COMMANDS[name]
    gone_after(runs)
    code, out, err = here(command, *arguments)
    assert code == 1, err
    assert err.count(GONE) == 1
    if "--notify" in arguments:
        assert Path("told").read_text() == f"1|error: {GONE}\n"
    if command is tune:
        assert f"error: {GONE}; resume it with: tune --resume " in err
    if name == "validate":
        assert f"error: {GONE}; continue with: validate " in err
    if "--json-lines" in arguments:
        assert json.loads(out.splitlines()[-1]).items() >= {"event": "end", "exit_code": 1}.items()


def test_nodes_that_are_gone_between_a_run_and_its_certificate(here, monkeypatch):
    first = iter([InProcessBackend.open])

    def open_once(backend):
        if (opened := next(first, None)) is None:
            raise BackendError(GONE)
        opened(backend)

    monkeypatch.setattr(InProcessBackend, "open", open_once)
    code, _, err = here(tune, *NEW, *NOTIFY, "--certify")
    assert code == 1, err
    assert err.count(GONE) == 1
    said = Path("told").read_text()
    assert said.startswith(f"1|no certificate: error: {GONE}; continue with: validate runs/")


def test_nodes_that_are_not_there_are_bad_input(here, monkeypatch):
    """Nothing has begun, and nobody is told."""

    def refuse(backend):
        raise BackendError(GONE)

    monkeypatch.setattr(InProcessBackend, "open", refuse)
    for command, *arguments in (COMMANDS["tune"], COMMANDS["try"], COMMANDS["check"]):
        assert here(command, *arguments)[0] == 2
    assert not Path("told").exists()
