"""A stranger's run folder: nothing in it is run, followed or believed to be a file of the run."""

import os
import shutil
import sqlite3
import stat
import struct
import subprocess
import sys
from dataclasses import replace

import pytest
from axis import write_axis
from in_process import Uninterrupted
from small_run import make_run

from bo_tuner.cli import replay, report, tune, validate
from bo_tuner.errors import JournalError, OutputError, RunRecordError
from bo_tuner.storage.journal import Journal
from bo_tuner.storage.journal_reader import read_journal
from bo_tuner.storage.record import read_run
from bo_tuner.storage.run_folder import LOCK, RunFolder
from bo_tuner.storage.trust import foreign_programs, is_trusted, python_functions, trust
from bo_tuner.study.study_file import load_study, shipped_studies, study_from_mapping


@pytest.fixture(scope="module")
def strangers(tmp_path_factory):
    folder = tmp_path_factory.mktemp("strangers") / "run"
    make_run(folder)
    return folder


@pytest.fixture
def run(strangers, tmp_path, monkeypatch):
    """A run folder by somebody else, whose object would leave a mark."""
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(__import__("sys").modules, "runs_axis", raising=False)
    write_axis(tmp_path, "runs_axis")
    text = (tmp_path / "runs_axis.py").read_text()
    mark = tmp_path / "imported"
    (tmp_path / "runs_axis.py").write_text(f"open({str(mark)!r}, 'w').close()\n{text}")
    shutil.copytree(strangers, tmp_path / "run")
    return tmp_path / "run"


def call(command, *arguments):
    return command.run([str(argument) for argument in arguments], Uninterrupted())


COMMANDS = [
    pytest.param(replay, ["RUN"], id="replay"),
    pytest.param(validate, ["RUN", "--trial", "0"], id="validate"),
    pytest.param(tune, ["--resume", "RUN"], id="resume"),
]


class TestPrograms:
    @pytest.mark.parametrize(("command", "arguments"), COMMANDS)
    def test_nothing_is_imported_unasked(self, run, capsys, command, arguments):
        given = [run if argument == "RUN" else argument for argument in arguments]
        assert call(command, *given) == 2
        (line,) = capsys.readouterr().err.splitlines()[-1:]
        assert "would start runs_axis:Axis, and was never run here by you" in line
        assert not (run.parent / "imported").exists()
        assert call(command, *given, "--trust") in (0, 3)
        assert (run.parent / "imported").exists()

    def test_a_report_says_why_it_has_no_trajectories(self, run):
        assert call(report, run) == 0
        assert "never run here by you" in (run / "report.html").read_text()
        assert not (run.parent / "imported").exists()
        assert call(report, run, "--trust") == 0
        assert "never run here by you" not in (run / "report.html").read_text()
        assert (run.parent / "imported").exists()

    def test_what_the_user_ran_here_is_trusted_wherever_it_lies(self, run, tmp_path):
        study = tmp_path / "mine.yaml"
        shutil.copy(run / "study.yaml", study)
        arguments = ["--study", study, "--trials", "3", "--backend", "inprocess", "--quiet"]
        assert call(tune, *arguments, "--output", tmp_path / "runs") in (0, 3)
        (made,) = (tmp_path / "runs").glob("function-*")
        moved = made.rename(tmp_path / "elsewhere")
        assert call(replay, moved) == 0
        assert is_trusted(read_run(moved).study)

    def test_a_study_that_follows_an_earlier_run_is_trusted_as_any_other(self, run, tmp_path):
        study = tmp_path / "mine.yaml"
        shutil.copy(run / "study.yaml", study)
        arguments = ["--from", run, "--study", study, "--trials", "4", "--quiet"]
        assert call(tune, *arguments, "--output", tmp_path / "runs") in (0, 3)
        (made,) = (tmp_path / "runs").glob("function-*")
        assert is_trusted(read_run(made).study)
        assert call(replay, made) == 0

    def test_another_study_with_the_same_program_is_another_matter(self, run):
        study = read_run(run).study
        trust(study)
        assert is_trusted(study.replace(trials=9, seed=4))
        (run / "study.yaml").write_text(
            (run / "study.yaml").read_text().replace("bounds: [0.0, 1.0]", "bounds: [0.0, 9.0]")
        )
        changed = load_study(run / "study.yaml")
        assert changed != study
        assert not is_trusted(changed)

    def test_a_marker_in_the_run_folder_counts_for_nothing(self, run, monkeypatch):
        (run / "bo_tuner" / "trusted").mkdir(parents=True)
        monkeypatch.setenv("XDG_STATE_HOME", "run")
        monkeypatch.chdir(run.parent)
        monkeypatch.setenv("HOME", str(run.parent / "home"))
        trust(read_run(run).study)
        assert not list((run / "bo_tuner" / "trusted").iterdir())
        assert list((run.parent / "home" / ".local" / "state" / "bo_tuner" / "trusted").iterdir())

    def test_trust_that_cannot_be_noted_down(self, run):
        (run.parent / "state").touch()
        with pytest.raises(OutputError, match="cannot be written"):
            trust(read_run(run).study)

    @pytest.mark.parametrize("name", shipped_studies())
    def test_shipped_studies_are_trusted(self, name):
        assert foreign_programs(load_study(name)) == []

    def test_a_folder_of_code_is_not_trusted_for_the_names_of_a_shipped_study(self):
        """What lies there may stand in for a module that is not installed."""
        shipped = load_study(shipped_studies()[0])
        assert foreign_programs(replace(shipped, folder="/strange")) == ["code in /strange"]


@pytest.mark.parametrize(
    ("node", "programs"),
    [
        ({"command": "python pid.py -x"}, ["python pid.py -x"]),
        ({"launch": "robot up.launch.py"}, ["ros2 launch robot up.launch.py"]),
        (
            {"package": "milling_plant", "executable": "milling_plant"},
            [],
        ),
        # A variable can make another program of one that is known.
        (
            {
                "package": "milling_plant",
                "executable": "milling_plant",
                "env": {"LD_PRELOAD": "/tmp/x.so"},
            },
            ["LD_PRELOAD=/tmp/x.so milling_plant/milling_plant"],
        ),
    ],
)
def test_what_a_study_of_unchanged_nodes_would_start(node, programs):
    mapping = {
        "name": "others",
        "nodes": {"pid": {"node": "pid", **node}},
        "parameters": {
            "kp": {"node": "pid", "type": "double", "bounds": [0, 1], "default": 0.5},
        },
        "signals": {"x": {"topic": "x", "field": "data"}},
        "run": {"end": {"after": 1.0}},
        "metrics": {"own": {"python": "users_metrics:energy"}},
        "objective": {"metric": "own"},
        "budget": {"trials": 1, "initial_trials": 1},
    }
    study = study_from_mapping(mapping)
    assert foreign_programs(study) == [*programs, "users_metrics:energy"]
    assert python_functions(study) == ["users_metrics:energy"]


PLACES = [
    "study.yaml", "journal.sqlite", "best.yaml", "summary.json", ".lock", "trials.csv",
    "evaluations.csv", "certificate.json", "report.html", "log", "bags", "deploy",
    "deploy/rollback.yaml", "deploy/parameters.yaml", "bags/trial_0000/metadata.yaml",
    "log/axis.log",
]  # fmt: skip


class TestFiles:
    @pytest.mark.timeout(60)
    @pytest.mark.parametrize("place", PLACES)
    @pytest.mark.parametrize("kind", ["link", "pipe", "socket"])
    def test_only_files_and_folders(self, run, tmp_path, place, kind):
        victim = tmp_path / "victim"
        victim.write_text("precious")
        path = run / place
        path.parent.mkdir(parents=True, exist_ok=True)
        path.unlink(missing_ok=True)
        if kind == "link":
            path.symlink_to(victim)
        else:
            os.mknod(path, (stat.S_IFIFO if kind == "pipe" else stat.S_IFSOCK) | 0o600)
        with pytest.raises(RunRecordError, match="expected only files and folders") as caught:
            read_run(run)
        assert str(path) in str(caught.value)
        assert victim.read_text() == "precious"

    def test_what_nodes_leave_in_the_log_is_theirs(self, run):
        (run / "log").mkdir(exist_ok=True)
        (run / "log" / "latest").symlink_to("2026-01-01")
        read_run(run)
        assert (run / "log" / "latest").is_symlink()

    @pytest.mark.timeout(60)
    @pytest.mark.parametrize("kind", ["link", "pipe"])
    def test_the_lock(self, tmp_path, kind):
        victim = tmp_path / "victim"
        victim.write_text("precious")
        if kind == "link":
            (tmp_path / LOCK).symlink_to(victim)
        else:
            os.mkfifo(tmp_path / LOCK)
        with pytest.raises(OutputError, match="cannot write there"):
            RunFolder(tmp_path)
        assert victim.read_text() == "precious"


class TestJournal:
    @pytest.mark.parametrize(
        "statement",
        [
            "CREATE TRIGGER t AFTER INSERT ON session BEGIN DELETE FROM trial; END",
            "CREATE VIEW v AS SELECT * FROM trial",
            "CREATE INDEX i ON trial (origin)",
            "CREATE TABLE more (x)",
            "ALTER TABLE trial ADD COLUMN more TEXT",
            "CREATE VIRTUAL TABLE f USING fts5(x)",
        ],
    )
    def test_objects_of_others_are_refused(self, run, statement):
        path = run / "journal.sqlite"
        db = sqlite3.connect(path)
        db.execute(statement)
        db.close()
        for look in (lambda: read_journal(path), lambda: Journal(path, {})):
            with pytest.raises(JournalError, match="is not as in a journal"):
                look()

    def test_a_view_in_place_of_a_table_is_not_evaluated(self, run):
        path = run / "journal.sqlite"
        db = sqlite3.connect(path)
        db.executescript(
            "ALTER TABLE trial RENAME TO old;"
            "CREATE VIEW trial AS SELECT *, load_extension('x') FROM old;"
        )
        db.close()
        with pytest.raises(JournalError, match="is not as in a journal"):
            read_journal(path)

    HALF = """
import os, sqlite3, sys
db = sqlite3.connect(sys.argv[1], isolation_level=None)
db.execute("PRAGMA journal_mode = DELETE")
db.execute("PRAGMA cache_size = 1")
db.execute("BEGIN")
for _ in range(200):
    db.execute("INSERT INTO session VALUES (?, 1)", ("x" * 4000,))
os._exit(0)
"""

    def half_written(self, run):
        """Kill a writer in the middle of a change, as at the end of a run."""
        path = run / "journal.sqlite"
        subprocess.run([sys.executable, "-c", self.HALF, path], check=True)
        rollback = run / "journal.sqlite-journal"
        assert rollback.stat().st_size > 1000
        return path, rollback

    def test_a_change_half_made_is_taken_back(self, strangers, run):
        path, rollback = self.half_written(run)
        whole = read_journal(strangers / "journal.sqlite")
        assert read_journal(path) == whole
        assert not rollback.exists()

    def test_a_rollback_journal_deletes_no_file_of_others(self, run, tmp_path):
        path, rollback = self.half_written(run)
        victim = tmp_path / "victim"
        victim.write_text("precious")
        name = bytes(victim)
        record = struct.pack(">I", 2**30 // 4096 + 1) + name
        record += struct.pack(">II", len(name), sum(name)) + bytes.fromhex("d9d505f920a163d7")
        with rollback.open("ab") as file:
            file.write(record)
        for look in (lambda: read_journal(path), lambda: Journal(path, {})):
            with pytest.raises(JournalError, match="names another file"):
                look()
        assert victim.read_text() == "precious"
