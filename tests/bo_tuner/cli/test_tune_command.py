"""The command: exit codes, one line for each mistake, and what stays after an interruption.

The evaluations are those of a small object in this process; tests/ros has the same on nodes.
"""

import json
import os
import pty
import re
import resource
import signal
import sys
from functools import partial
from pathlib import Path

import pytest
from axis import node, write_axis, write_study
from commands import Fork, finish, rows, run, start
from in_process import call, complaint
from waiting import DEADLINE, catches, count_in, wait_until

from bo_tuner.cli import tune as tune_command
from bo_tuner.cli.common import split_ros_arguments
from bo_tuner.errors import JournalError
from bo_tuner.evidence.run_verdict import run_verdict
from bo_tuner.evidence.words.next_steps import next_steps
from bo_tuner.report.sections import convergence
from bo_tuner.storage.journal_reader import read_journal
from bo_tuner.storage.record import read_run
from bo_tuner.trials import EvaluationState, TrialState


@pytest.fixture
def study_file(tmp_path, make_study):
    return write_study(tmp_path, make_study())


@pytest.fixture
def tune(tmp_path, study_file):
    """Function that starts the command on the small object."""
    return partial(begin, Fork, tmp_path, study_file)


@pytest.fixture
def fresh_tune(tmp_path, study_file):
    """The same with an interpreter of its own, and options of `subprocess.Popen`."""
    return partial(begin, start, tmp_path, study_file)


def begin(run, folder, study, *arguments, environment=None, **options):
    return run(*command(study, *arguments), folder=folder, env=environment, **options)


def command(study, *arguments):
    return ("tune", "--backend", "inprocess", "--study", study, *arguments)


def latest(tmp_path):
    return tmp_path / "runs" / "latest"


def recorded(folder):
    return list(read_journal(folder / "journal.sqlite").trials)


@pytest.mark.parametrize("options", [[], ["--study", "full"]])
@pytest.mark.parametrize("backend", ["ros", "inprocess"])
def test_without_the_machine_that_comes_along_it_says_what_to_do(
    capsys, monkeypatch, tmp_path, backend, options
):
    """As from a package index: the tuner alone is installed."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "prefix", str(tmp_path))
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path))
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setitem(sys.modules, "milling_plant", None)
    line = complaint(tune_command, capsys, "--backend", backend, *options)
    assert "needs the package milling_plant, which is not installed" in line
    assert "init my_study.yaml" in line
    assert "tune --study my_study.yaml" in line
    assert not list(tmp_path.iterdir())


class TestRun:
    def test_feasible(self, fresh_tune, tmp_path):
        code, out, err = finish(fresh_tune())
        assert code == 0, err
        folder = latest(tmp_path)
        assert {path.name for path in folder.iterdir()} == {
            ".lock", "best.yaml", "evaluations.csv", "deploy", "journal.sqlite", "log",
            "report.html",
            "study.yaml", "summary.json", "trials.csv",
        }  # fmt: skip
        assert [trial.number for trial in recorded(folder)] == list(range(5))
        summary = json.loads((folder / "summary.json").read_text())
        assert summary["feasible"] is True
        assert summary["tuned"]["draws"] == summary["default"]["draws"] == 5
        (error,) = [q for q in summary["verdict"]["quantities"] if q["objective"]]
        assert error["tuned"] < error["default"]
        # One plain line for each trial, none broken, and the table on stdout alone.
        lines = err.splitlines()
        assert len(rows(lines)) == 5
        assert "\x1b" not in out + err
        assert "against the default, in the same 5 fresh test runs" in out
        assert str(Path("runs") / folder.readlink() / "best.yaml") in out

    @pytest.mark.parametrize("algorithm", ["boundary", "IV"])
    def test_its_report_is_that_of_the_record(self, tune, tmp_path, algorithm):
        """Although the incumbents in it are those that the run has found."""
        code, _, err = finish(tune("--algorithm", algorithm))
        assert code in (0, 3), err
        for resumed in (False, True):
            if resumed:
                code, _, err = run("tune", "--resume", "latest", "--trials", "7", folder=tmp_path)
                assert code in (0, 3), err
            page = (latest(tmp_path) / "report.html").read_bytes()
            code, _, err = run("report", "latest", folder=tmp_path)
            assert code == 0, err
            assert (latest(tmp_path) / "report.html").read_bytes() == page

    def test_its_report_takes_the_incumbents_that_it_has_found(
        self, make_study, tmp_path, monkeypatch, capsys
    ):
        """Each would be another fit of all models."""
        # A module of the same name may be known in this process.
        study_file = write_study(tmp_path, make_study(nodes=node("remembered_axis")))
        monkeypatch.chdir(tmp_path)
        monkeypatch.syspath_prepend(tmp_path)
        monkeypatch.setattr(
            convergence, "_incumbent", lambda analysis, count: pytest.fail(str(count))
        )
        code, out, err = call(tune_command, capsys, *command(study_file)[1:])
        assert code == 0, err
        assert "report: " in out + err
        assert "warning" not in err

    def test_not_feasible(self, tune, tmp_path):
        code, out, err = finish(tune(environment={"PEAK": "2"}))
        assert code == 3, err
        text = (latest(tmp_path) / "best.yaml").read_text()
        assert text.startswith("# DO NOT USE: ")
        assert json.loads((latest(tmp_path) / "summary.json").read_text())["feasible"] is False
        assert out.startswith("No feasible parameter set was found: ")
        assert "best.yaml holds this set, which is not within limits: do not use it." in out

    def test_every_trial_fails(self, tune, tmp_path):
        code, _, err = finish(tune(environment={"FAILING": "1000"}))
        assert code == 3
        assert err.count("FAILED: axis: stalled [/x] for good (context load ") == 5
        assert {trial.state for trial in recorded(latest(tmp_path))} == {TrialState.FAILED}
        assert not (latest(tmp_path) / "best.yaml").exists()
        # What to do is said as in the report.
        run = read_run(latest(tmp_path))
        folder = latest(tmp_path).resolve().relative_to(tmp_path.resolve())
        (step,) = next_steps(run_verdict(run), str(folder))
        assert step.command.endswith(" --trials 8")
        assert f"\nnext:\n  {step.command}  {step.purpose}\n" in err

    def test_one_seed_one_run(self, tune, tmp_path):
        for name in ("a", "b"):
            code, _, err = finish(tune("--seed", "3", "--trials", "4", "--output", name))
            assert code == 0, err
        first, second = (
            [(tmp_path / name / "latest" / file).read_bytes() for file in
             ("trials.csv", "evaluations.csv", "best.yaml", "summary.json", "study.yaml")]
            for name in ("a", "b")
        )  # fmt: skip
        assert first == second

    def test_a_terminal_gets_a_bar(self, fresh_tune):
        leader, follower = pty.openpty()
        process = fresh_tune(
            stdin=follower,
            stdout=follower,
            stderr=follower,
            environment={"TERM": "xterm-256color", "COLUMNS": "100", "PACE": "0.02"},
        )
        os.close(follower)
        shown = b""
        while True:
            try:
                chunk = os.read(leader, 4096)
            except OSError:
                break
            if not chunk:
                break
            shown += chunk
        os.close(leader)
        assert process.wait(DEADLINE) == 0, shown
        text = re.sub(r"\x1b\[[0-9;?]*[a-zA-Z]", "", shown.decode())
        assert "5/5" in text
        assert "best within limits: trial" in text
        assert "validation" in text

    def test_a_terminal_without_our_signs(self, fresh_tune):
        environment = {"PYTHONIOENCODING": "ascii", "LC_ALL": "C", "PYTHONUTF8": "0"}
        code, out, err = finish(fresh_tune("--trials", "1", environment=environment))
        assert code == 0, err
        assert "keeps all limits" in out


class TestInterruption:
    @pytest.mark.parametrize(
        ("signum", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)], ids=["int", "term"]
    )
    @pytest.mark.parametrize("evaluations", [3, 22], ids=["tuning", "validation"])
    def test_the_record_stays(self, tune, tmp_path, signum, code, evaluations):
        """A run has 5 trials of 4 evaluations, so that evaluation 22 is one of the validation."""
        counter = tmp_path / "cuts"
        process = tune(environment={"CUTS": str(counter), "HOLD": str(evaluations)})
        wait_until(lambda: count_in(counter) == evaluations, "the evaluation", process)
        process.send_signal(signum)
        (tmp_path / "cuts.go").touch()
        found, _, err = finish(process)
        assert found == code, err
        assert "interrupted by" in err.splitlines()[-1]
        folder = latest(tmp_path)
        trials = recorded(folder)
        assert len(trials) == min(evaluations // 4, 5)
        lines = (folder / "evaluations.csv").read_text().splitlines()
        assert len(lines) - 1 == evaluations
        assert not (folder / "best.yaml").exists()

    @pytest.mark.parametrize("evaluations", [0, 1], ids=["imports", "evaluation"])
    def test_at_the_start(self, fresh_tune, tmp_path, evaluations):
        counter = tmp_path / "cuts"
        process = fresh_tune(environment={"CUTS": str(counter), "HOLD": "1"})
        # Python itself needs a moment until it can be told anything.
        wait_until(lambda: catches(process.pid), "its handlers", process)
        wait_until(lambda: count_in(counter) >= evaluations, "the evaluation", process)
        process.send_signal(signal.SIGINT)
        (tmp_path / "cuts.go").touch()
        code, _, err = finish(process)
        assert code == 130, err


class TestFaults:
    def test_a_full_disk(self, fresh_tune, tmp_path):
        def limit():
            resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, 100_000))

        process = fresh_tune("--trials", "200", environment={"PEAK": "2"}, preexec_fn=limit)
        code, _, err = finish(process)
        assert code == 1, err
        last = err.splitlines()[-1]
        assert last.startswith("error: ")
        assert "journal.sqlite" in last
        assert "resume it with: tune --resume " in last
        assert sum(line.startswith("error") for line in err.splitlines()) == 1
        # What was told as done is in the record.
        told = len(rows(err.splitlines()))
        assert len(recorded(latest(tmp_path))) in (told, told + 1)

    def test_a_disk_that_is_full_before_there_is_a_record(
        self, study_file, tmp_path, monkeypatch, capsys
    ):
        """There is nothing to resume, so no folder stays."""

        def journal(path, *_):
            raise JournalError(f"{path}: no space") from OSError(28, "No space left on device")

        monkeypatch.syspath_prepend(tmp_path)
        monkeypatch.chdir(tmp_path)
        monkeypatch.setattr("bo_tuner.cli.session.Journal", journal)
        arguments = command(study_file)[1:]
        line = complaint(tune_command, capsys, *arguments, code=1)
        assert line.endswith("journal.sqlite: no space")
        assert [path for path in (tmp_path / "runs").iterdir() if not path.is_symlink()] == []

    def test_a_table_that_cannot_be_written(self, tune, tmp_path):
        counter = tmp_path / "cuts"
        process = tune(environment={"CUTS": str(counter), "HOLD": "1"})
        wait_until(lambda: count_in(counter) == 1, "the evaluation", process)
        (latest(tmp_path) / "trials.csv").mkdir()
        (tmp_path / "cuts.go").touch()
        code, _, err = finish(process)
        assert code == 1
        assert "trials.csv: cannot be written: Is a directory" in err.splitlines()[-1]

    def test_a_reader_that_went_away(self, tune):
        """As in `tune | head -0`."""
        leader, follower = os.pipe()
        process = tune("--trials", "1", stdout=follower)
        os.close(follower)
        os.close(leader)
        _, err = process.communicate(timeout=DEADLINE)
        assert "Traceback" not in err, err
        assert process.returncode not in (0, 2)


@pytest.fixture
def refusal(tmp_path, study_file, monkeypatch, capsys):
    """Function that runs the command in this process and returns its one line of complaint."""
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.chdir(tmp_path)
    return partial(complaint, tune_command, capsys)


class TestBadInput:
    @pytest.mark.parametrize(
        ("arguments", "complaint"),
        [
            (["--study", ""], "unknown study ''; shipped are benchmark, full"),
            (["--study", "bench"], "unknown study 'bench'; shipped are benchmark, full"),
            (["--study", "./nowhere.yaml"], "./nowhere.yaml: cannot be read: No such file"),
            (["--study", "./"], "cannot be read: Is a directory"),
            (["--trials", "0"], "--trials: expected an integer of at least 1, found 0"),
            (["--trials", "-1"], "--trials: expected an integer of at least 1, found -1"),
            (["--trials", "x"], "argument --trials: x: expected a whole number"),
            (["--trials", "1.5"], "argument --trials: 1.5: expected a whole number"),
            (["--trials"], "argument --trials: expected one argument"),
            (["--seed", "-1"], "--seed: expected an integer of at least 0, found -1"),
            (["--seed", "9" * 30], "--seed: "),
            (["--algorithm", "VI"], "argument --algorithm: invalid choice: 'VI'"),
            (["--backend", "ross"], "argument --backend: invalid choice: 'ross'"),
            (["--tri", "3"], "unrecognized arguments: --tri 3"),
            (["--record", "some"], "argument --record: invalid choice: 'some' (choose from 'all'"),
            (["a.yaml"], "unrecognized arguments: a.yaml; did you mean --study a.yaml?"),
            (["--ros-args", "-r", "__ns:=cell"], "__ns:=cell: a namespace begins with a slash"),
            (["--attach", "--backend", "inprocess"], "--attach needs --backend ros"),
        ],
    )
    def test_options(self, refusal, arguments, complaint):
        assert complaint in refusal(*arguments)

    @pytest.mark.parametrize(
        ("old", "new", "complaint"),
        [
            ("objective:", "objectiv:", "objectiv: unknown key; did you mean 'objective'?"),
            ("upper: 1.0", "upper: high", "constraints.peak.upper: "),
            ("[0.0, 1.0]", "[1.0, 0.0]", "parameters.gain.bounds"),
            ("axis_objects:Axis", "axis_objects:Nothing", "nodes.axis.object: cannot load"),
            ("axis_objects:Axis", "no_such_module:Axis", "No module named 'no_such_module'"),
        ],
    )
    def test_studies(self, refusal, study_file, old, new, complaint):
        text = study_file.read_text()
        assert old in text
        study_file.write_text(text.replace(old, new))
        assert complaint in refusal("--backend", "inprocess", "--study", str(study_file))

    def test_a_start_that_fails_leaves_no_folder(self, refusal, study_file, tmp_path):
        study_file.write_text(study_file.read_text().replace("axis_objects:Axis", "no_such:Axis"))
        refusal("--backend", "inprocess", "--study", str(study_file))
        assert list((tmp_path / "runs").iterdir()) == []

    def test_a_resume_that_fails_leaves_the_run(self, tune, study_file, tmp_path, refusal):
        assert finish(tune())[0] == 0
        folder = latest(tmp_path).resolve()
        before = {path.name: path.read_bytes() for path in folder.iterdir() if path.is_file()}
        (tmp_path / "axis_objects.py").rename(tmp_path / "elsewhere.py")
        sys.modules.pop("axis_objects", None)
        line = refusal("--resume", str(folder), "--trials", "6", warnings=1)
        assert "No module named 'axis_objects'" in line
        for name in ("study.yaml", "summary.json", "best.yaml"):
            assert (folder / name).read_bytes() == before[name]
        assert read_run(folder).study.budget.trials == 5

    def test_a_study_error_names_file_and_line(self, refusal, study_file):
        lines = study_file.read_text().splitlines()
        number = next(k for k, line in enumerate(lines, 1) if line.startswith("objective:"))
        lines[number - 1] = "objectiv:"
        study_file.write_text("\n".join(lines))
        line = refusal("--study", str(study_file))
        assert line.startswith(f"error: {study_file}:{number}: objectiv: unknown key")

    def test_all_study_errors_are_told_a_line_each(self, study_file, capsys):
        text = study_file.read_text().replace("upper: 1.0", "upper: high")
        study_file.write_text(text.replace("[0.0, 1.0]", "[1.0, 0.0]"))
        code, _, errors = call(tune_command, capsys, "--study", str(study_file))
        assert code == 2
        lines = errors.splitlines()
        assert [line.split(": ")[0] for line in lines] == ["error", "error"]
        assert "parameters.gain.bounds: lower bound" in lines[0]
        assert "constraints.peak.upper: " in lines[1]

    @pytest.mark.parametrize("output", ["file", "file/sub", "/proc/runs"])
    def test_output_cannot_be_written(self, refusal, study_file, tmp_path, output):
        (tmp_path / "file").touch()
        line = refusal("--study", str(study_file), "--backend", "inprocess", "--output", output)
        assert line.startswith(f"error: {output}: cannot write runs there: ")

    def test_latest_is_in_the_way(self, refusal, study_file, tmp_path):
        (tmp_path / "runs" / "latest").mkdir(parents=True)
        line = refusal("--study", str(study_file), "--backend", "inprocess")
        assert "latest: cannot point to the run" in line


@pytest.mark.parametrize(
    ("given", "own", "ros"),
    [
        ([], [], []),
        (["--trials", "3"], ["--trials", "3"], []),
        (
            ["--trials", "3", "--ros-args", "-r", "__ns:=/a"],
            ["--trials", "3"],
            ["--ros-args", "-r", "__ns:=/a"],
        ),
        (
            ["--ros-args", "-r", "__ns:=/a", "--", "--trials", "3"],
            ["--trials", "3"],
            ["--ros-args", "-r", "__ns:=/a", "--"],
        ),
        (["--ros-args", "--", "--ros-args"], [], ["--ros-args", "--", "--ros-args"]),
        (["--", "x"], ["--", "x"], []),
    ],
)
def test_ros_arguments_are_told_from_own_ones(given, own, ros):
    assert split_ros_arguments(given) == (own, ros)


def test_an_evaluation_that_raises_is_a_failed_evaluation(tune, tmp_path):
    """Also one that raises what only looks like an interruption of ours."""
    write_axis(tmp_path, fails="exec(\"raise RuntimeError('interrupted')\")")
    code, _, err = finish(tune("--trials", "1"))
    assert code == 3, err
    (trial,) = recorded(latest(tmp_path))
    assert trial.reason == "RuntimeError: interrupted"
    assert trial.evaluations[0].outcome.state is EvaluationState.FAILED
