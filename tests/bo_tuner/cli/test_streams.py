"""Commands whose terminal goes away, or whose output nobody takes, end in a line and a code."""

import os
import signal
import subprocess
import sys
import time

import pytest
from axis import node, write_study
from commands import Fork, environment, finish, run, several, start
from terminals import gone
from waiting import DEADLINE, count_in, wait_until

from bo_tuner.storage.record import read_run

COMMANDS = (("report",), ("replay",), ("validate", "--runs", "250"))


@pytest.fixture(scope="module")
def runs(tmp_path_factory, make_study):
    folder = tmp_path_factory.mktemp("streams")
    write_study(folder, make_study(nodes=node("streamed_axis")))
    code, _, err = run(*TUNE, folder=folder)
    assert code == 0, err
    return folder


TUNE = ("tune", "--study", "axis.yaml", "--backend", "inprocess", "--output", "runs")


def held(runs, tmp_path, *arguments, begin=Fork, **options):
    """Start a command that waits in an evaluation."""
    cuts = tmp_path / "cuts"
    process = begin(*arguments, folder=runs, env={"CUTS": str(cuts), "HOLD": "3"}, **options)
    wait_until(lambda: count_in(cuts) == 3, "the third evaluation", process)
    return process, cuts


def go_on(cuts):
    (cuts.parent / f"{cuts.name}.go").touch()


@pytest.mark.parametrize("command", [(*TUNE[:-1], "hung"), COMMANDS[2]], ids=lambda c: c[0])
@pytest.mark.parametrize("signum", [signal.SIGHUP, signal.SIGTERM, signal.SIGINT])
def test_a_signal_ends_a_command_once_and_for_all(runs, tmp_path, command, signum):
    """Whatever comes after the first one changes nothing."""
    arguments = command if command[0] == "tune" else (command[0], "runs/latest", *command[1:])
    process, cuts = held(runs, tmp_path, *arguments)
    for _ in range(3):
        process.send_signal(signum)
        # Two that wait to be taken count as one.
        time.sleep(0.02)
    go_on(cuts)
    code, _, err = finish(process)
    assert code == 128 + signum
    assert err.splitlines()[-1].startswith(f"interrupted by {signum.name}")
    if command[0] == "tune":
        assert len(read_run(runs / "hung" / "latest").trials) == 0


def test_under_nohup_the_terminal_may_go(runs, tmp_path):
    ignore = "import os, signal, sys; signal.signal(signal.SIGHUP, signal.SIG_IGN); "
    ignore += "os.execv(sys.executable, [sys.executable, '-m', 'bo_tuner', *sys.argv[1:]])"
    cuts = tmp_path / "cuts"
    process = subprocess.Popen(
        [sys.executable, "-c", ignore, *TUNE[:-1], str(tmp_path / "kept")],
        cwd=runs,
        env=environment(runs, CUTS=str(cuts), HOLD="3"),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    wait_until(lambda: count_in(cuts) == 3, "the third evaluation", process)
    process.send_signal(signal.SIGHUP)
    go_on(cuts)
    code, _, err = finish(process)
    assert code == 0, err


def test_a_terminal_that_is_gone_leaves_a_record_that_goes_on(runs, tmp_path):
    """The terminal takes no more output, and the signal comes with it."""
    ours, theirs = os.openpty()
    command = (*TUNE[:-1], str(tmp_path / "gone"))
    process, cuts = held(
        runs, tmp_path, *command, begin=start, stdin=theirs, stdout=theirs, stderr=theirs
    )
    os.close(theirs)
    os.close(ours)
    process.send_signal(signal.SIGHUP)
    go_on(cuts)
    assert process.wait(DEADLINE) == 128 + signal.SIGHUP
    assert len(read_run(tmp_path / "gone" / "latest").evaluations) == 3
    code, _, err = run("tune", "--resume", tmp_path / "gone" / "latest", folder=runs)
    assert code == 0, err


FULL = "error: output: No space left on device"
UNREAD = "error: the output pipe was closed"
GONE = pytest.mark.parametrize(
    ("kind", "code", "complaint"), [("full", 1, FULL), ("pipe", 128 + signal.SIGPIPE, UNREAD)]
)


@pytest.mark.parametrize("command", COMMANDS, ids=lambda command: command[0])
@pytest.mark.parametrize("to_error", [False, True])
@GONE
def test_output_that_nobody_takes(runs, command, to_error, kind, code, complaint):
    name, *options = command
    with gone(kind) as output:
        streams = {"stdout": output} | ({"stderr": output} if to_error else {})
        process = Fork(name, "runs/latest", *options, folder=runs, **streams)
    _, err = process.communicate(timeout=DEADLINE)
    assert process.returncode == code
    if not to_error:
        assert err.splitlines()[-1] == complaint
        assert "Traceback" not in err


@pytest.mark.parametrize("to_error", [False, True])
@GONE
def test_a_tuner_without_output_stops_with_its_record_whole(
    runs, tmp_path, to_error, kind, code, complaint
):
    with gone(kind) as output:
        streams = {"stdout": output} | ({"stderr": output} if to_error else {})
        process = Fork(*TUNE[:-1], str(tmp_path / "unheard"), folder=runs, **streams)
    _, err = process.communicate(timeout=DEADLINE)
    assert process.returncode == code
    if not to_error:
        assert err.splitlines()[-1] == complaint
        assert "Traceback" not in err
    code, _, err = run("tune", "--resume", tmp_path / "unheard" / "latest", folder=runs)
    assert code == 0, err


ALL = ("apply", "replay", "report", "tune", "validate", "benchmark")


def started(name, *arguments, folder, **streams):
    """Start one of all commands."""
    package = "tuning_benchmark" if name == "benchmark" else "bo_tuner"
    command = arguments if name == "benchmark" else (name, *arguments)
    return Fork(*command, folder=folder, package=package, **streams)


@pytest.mark.parametrize("name", ALL)
@pytest.mark.parametrize("option", ["--help", "--version"])
@GONE
def test_help_that_cannot_be_written_is_not_given(runs, name, option, kind, code, complaint):
    with gone(kind) as output:
        process = started(name, option, folder=runs, stdout=output)
    _, err = process.communicate(timeout=DEADLINE)
    assert (process.returncode, err) == (code, f"{complaint}\n")


@pytest.mark.parametrize("name", ALL)
def test_a_complaint_that_cannot_be_written_leaves_its_exit_code(runs, name):
    with gone("full") as output:
        process = started(name, "--unknown", folder=runs, stdout=output, stderr=output)
    assert process.wait(DEADLINE) == 2


@pytest.mark.parametrize("closed", [">&-", "2>&-", "<&- >&- 2>&-"])
def test_streams_that_were_closed_are_as_dev_null(runs, closed):
    done = subprocess.run(
        [
            *("sh", "-c", f'"$@" {closed}', "sh"),
            *several(*((name, "runs/latest", *options) for name, *options in COMMANDS)),
        ],
        cwd=runs,
        env=environment(runs),
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    assert "Traceback" not in done.stderr
