"""The command: what it writes, its exit codes, and one line for each mistake."""

from functools import partial

import pytest
from in_process import call

from bo_tuner.cli import report as report_command


@pytest.fixture
def report(capsys):
    """Function that runs the command; returns its exit code, output and errors."""
    return partial(call, report_command, capsys)


def test_the_report_goes_into_the_run_folder(report, tuned):
    code, out, err = report(tuned.path)
    path = tuned.path / "report.html"
    assert (code, out, err) == (0, f"report: {path}\n", "")
    assert path.stat().st_size < 8e6
    path.unlink()


def test_output_and_figures_go_where_they_are_told(report, tuned, tmp_path, importable):
    page, plots = tmp_path / "a" / "page.html", tmp_path / "plots"
    code, out, _ = report(tuned.path, "--output", page, "--figures", plots, "--format", "svg")
    assert code == 0
    assert page.is_file()
    names = sorted(path.name for path in plots.iterdir())
    assert "convergence.svg" in names
    assert "trajectories.svg" in names
    assert all(name.endswith(".svg") for name in names)
    written = [line.removeprefix("figure: ") for line in out.splitlines()[1:]]
    assert sorted(written) == [str(plots / name) for name in names]


def test_a_trial_has_a_file_of_its_own(report, tuned):
    code, out, err = report(tuned.path, "--trial", "0")
    path = tuned.path / "trial_0000.html"
    assert (code, out, err) == (0, f"report: {path}\n", "")
    assert "trial 0</h1>" in path.read_text(encoding="utf-8")
    path.unlink()


@pytest.mark.parametrize("number", ["-1", "7"])
def test_a_trial_that_is_not_there(report, tuned, number):
    code, out, err = report(tuned.path, "--trial", number)
    assert (code, out) == (2, "")
    assert err == f"error: {tuned.path}: no trial {number}; expected 0 to 6\n"


def test_latest_is_the_last_run(report, tuned, tmp_path, monkeypatch):
    (tmp_path / "runs").symlink_to(tuned.path.parent)
    monkeypatch.chdir(tmp_path)
    code, out, _ = report("latest", "--output", "page.html")
    assert (code, out) == (0, "report: page.html\n")


def test_a_run_folder_is_no_folder_of_runs(report, tuned):
    code, out, err = report("--serve", tuned.path)
    assert (code, out) == (2, "")
    assert err == f"error: --serve {tuned.path}: expected a folder of runs, found a run folder\n"


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["nowhere"], "nowhere: no such run folder"),
        (["latest"], "runs/latest: no such run folder"),
        (["."], "no run folder"),
        ([], "expected a run folder, or --serve FOLDER"),
        (["--serve", "nowhere"], "--serve nowhere: expected a folder of runs, found no folder"),
        (["--serve", ".", "a_run"], "--serve shows all runs of a folder; leave a run out"),
        (["--serve", ".", "--trial", "1"], "--serve shows all runs of a folder; leave --trial out"),
        (["a_run", "--web-port", "8080"], "--web-port needs --serve"),
        (["a_run", "--web-host", "0.0.0.0"], "--web-host needs --serve"),
        (
            ["--serve", ".", "--web-port", "x"],
            "argument --web-port: x: expected a port, 0 to 65535",
        ),
        (
            ["--serve", ".", "--web-host", "example.org"],
            "argument --web-host: example.org: expected an IPv4 address of this machine, or "
            "0.0.0.0 for all of them",
        ),
        # An address of documentation (RFC 5737), which no machine has.
        (["--serve", ".", "--web-host", "192.0.2.1"], "--web-host 192.0.2.1: cannot listen on"),
        ([".", "--format", "gif"], "argument --format: gif: expected one or more of png, svg"),
        ([".", ".", "--trial", "1"], "--trial: expected one run"),
        ([".", "--colour"], "unrecognized arguments: --colour"),
    ],
)
def test_a_mistake_is_one_line(report, tmp_path, monkeypatch, arguments, said):
    monkeypatch.chdir(tmp_path)
    code, out, err = report(*arguments)
    assert code == 2
    assert out == ""
    assert err.startswith("error: ")
    assert said in err
    assert err.count("\n") == 1


def test_a_file_in_the_way_is_one_line(report, tuned, tmp_path):
    (tmp_path / "file").write_text("")
    code, _, err = report(tuned.path, "--output", tmp_path / "file" / "page.html")
    assert (code, err.count("\n")) == (2, 1)
    assert "cannot be written" in err


def test_help_shows_examples_and_exit_codes(report):
    code, out, _ = report("--help")
    assert code == 0
    assert "exit codes:" in out
    assert "report latest --figures" in out
