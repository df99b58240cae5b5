"""The user's command at the end: what it is told, and that it changes nothing."""

import signal

import pytest
from axis import write_study
from commands import Fork, finish, run
from waiting import count_in, wait_until

from bo_tuner.cli import notify as notify_module
from bo_tuner.cli.notify import notify

TELL = 'echo "$BO_TUNER_EXIT_CODE|$BO_TUNER_FOLDER|$BO_TUNER_HEADLINE" >> told'


@pytest.fixture
def told(tmp_path):
    """Function for what the command was told in each of its calls."""

    def read():
        lines = (tmp_path / "told").read_text().splitlines()
        return [tuple(line.split("|", 2)) for line in lines]

    return read


@pytest.fixture
def tune(tmp_path, make_study):
    write_study(tmp_path, make_study())
    return ["tune", "--backend", "inprocess", "--study", "axis.yaml", "--quiet"]


def test_at_the_end_of_a_run_and_of_a_certificate(tmp_path, tune, told):
    code, _, err = run(*tune, "--notify", TELL, folder=tmp_path)
    assert (code, err) == (0, "")
    folder = str((tmp_path / "runs" / "latest").resolve())
    ((exit_code, where, headline),) = told()
    assert (exit_code, where) == ("0", folder)
    assert "; no limit broken in " in headline
    code, out, _ = run("validate", "runs/latest", "--notify", TELL, folder=tmp_path)
    assert told()[1][:2] == (str(code), folder)
    # The same words as on the screen.
    assert told()[1][2] in out.splitlines()[0]


@pytest.mark.parametrize(("signum", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_after_an_interruption(tmp_path, tune, told, signum, code):
    counter = tmp_path / "cuts"
    environment = {"CUTS": str(counter), "HOLD": "3"}
    process = Fork(*tune, "--notify", TELL, folder=tmp_path, env=environment)
    wait_until(lambda: count_in(counter) == 3, "the evaluation", process)
    process.send_signal(signum)
    (tmp_path / "cuts.go").touch()
    assert finish(process)[0] == code
    ((exit_code, _, headline),) = told()
    assert (exit_code, headline) == (str(code), f"interrupted by {signum.name}")


def test_a_run_that_does_not_start_tells_nobody(tmp_path, tune):
    code, _, _ = run(*tune, "--trials", "0", "--notify", TELL, folder=tmp_path)
    assert code == 2
    assert not (tmp_path / "told").exists()


def test_one_that_fails_is_a_warning(tmp_path, tune):
    code, out, err = run(*tune, "--notify", "echo spoilt; exit 7", folder=tmp_path)
    assert code == 0
    # Standard output is that of the run alone.
    assert "spoilt" not in out
    assert err.splitlines() == [
        "spoilt",
        "warning: --notify: the command failed with exit code 7",
    ]


def test_one_that_hangs_is_ended(tmp_path, monkeypatch):
    """With what it has started: the pipe is closed only once all who have it have ended."""
    monkeypatch.setattr(notify_module, "PATIENCE", 0.2)
    warnings = []
    fifo = tmp_path / "fifo"
    notify(f"mkfifo {fifo}; sleep 1000 > {fifo} & cat < {fifo}", tmp_path, 0, "", warnings.append)
    assert warnings == ["warning: --notify: the command did not end within 0.2 s, and was ended"]


def test_without_one_nothing_is_run(tmp_path):
    notify(None, tmp_path, 0, "", pytest.fail)
