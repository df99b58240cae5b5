"""The other runs in the folder of a run in progress, listed and compared."""

import os
import re
import shutil
from pathlib import Path

import pytest

from bo_tuner.evidence.run_verdict import run_verdict
from bo_tuner.evidence.words.verdict import headline
from bo_tuner.storage.journal import Journal
from bo_tuner.storage.provenance import session_provenance
from bo_tuner.storage.record import read_run
from bo_tuner.study.study_file import study_to_yaml
from bo_tuner.tuning.summary import with_summary
from bo_tuner.web.runs import Runs


class TestOtherRuns:
    def test_they_are_listed_with_their_verdicts(self, beside):
        page = beside.listing()
        rows = re.findall(r'<input type="checkbox" name="run" value="([^"]+)"', page)
        assert rows == [beside.name, beside.finished_one]
        assert "no limit broken" in page
        assert re.search(r"No result yet: \d of 5 trials", page)
        assert "broken: " in page

    def test_the_report_of_one(self, beside):
        status, _, page = beside.ask(f"/runs/{beside.finished_one}")
        assert status == 200
        assert "no limit broken" in page

    def test_side_by_side(self, beside):
        status, _, page = beside.ask(f"/compare?run={beside.name}&run={beside.finished_one}")
        assert status == 200
        assert "2 runs side by side" in page
        assert "no limit broken" in page

    @pytest.mark.parametrize(
        ("query", "status"),
        [("", 400), ("run={0}", 400), ("run={0}&run={0}", 400), ("run={0}&run=none", 404),
         ("run={0}&run=..", 404), ("run={0}&run=broken", 409),
         ("&".join(f"run={k}" for k in range(9)), 400)],
    )  # fmt: skip
    def test_what_cannot_be_compared(self, beside, query, status):
        found, _, text = beside.ask(f"/compare?{query.format(beside.name)}")
        assert found == status
        assert len(text.splitlines()) == 1

    @pytest.mark.parametrize("name", ["none", "..", "%2e%2e", "..%2f..%2fetc", "latest"])
    def test_only_runs_in_the_folder_are_shown(self, beside, name):
        assert beside.ask(f"/runs/{name}")[0] == 404

    def test_a_run_is_read_again_once_it_has_changed(self, beside):
        before = beside.listing()
        assert beside.listing() == before
        path = beside.folder.parent / beside.finished_one / "study.yaml"
        content = path.read_text()
        path.write_text("no study")
        try:
            assert "no limit broken" not in beside.listing()
        finally:
            path.write_text(content)


def lose_summary(run):
    (run / "summary.json").unlink()


def go_on(run):
    """Begin a session with more trials, which is cut short at once."""
    study = read_run(run).study.replace(trials=20)
    with Journal(run / "journal.sqlite", session_provenance(study, "inprocess", "boundary")):
        (run / "study.yaml").write_text(study_to_yaml(study))


@pytest.mark.parametrize(
    ("change", "verdict"), [(lose_summary, "no limit broken"), (go_on, "No result yet: 5 of 20")]
)
def test_a_summary_that_is_missing_or_of_an_earlier_session(beside, tmp_path, change, verdict):
    """The verdict is that of the commands."""
    run = shutil.copytree(beside.folder.parent / beside.finished_one, tmp_path / "run")
    change(run)
    assert verdict in Runs(tmp_path, "none").listing()
    assert verdict in headline(run_verdict(with_summary(read_run(run), str)))


def test_a_run_that_is_deleted_meanwhile_is_not_listed(tmp_path, monkeypatch):
    for name in ("kept", "deleted"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "journal.sqlite").touch()
    is_file = Path.is_file

    def deleted_afterwards(path):
        found = is_file(path)
        if path.parent.name == "deleted":
            shutil.rmtree(path.parent)
        return found

    monkeypatch.setattr(Path, "is_file", deleted_afterwards)
    assert Runs(tmp_path, "kept").names() == ["kept"]


@pytest.fixture
def in_progress(tmp_path, make_study):
    """Function for the open journal of a run without a trial in a folder of that name."""
    journals = []

    def begin(name):
        (tmp_path / name).mkdir()
        (tmp_path / name / "study.yaml").write_text(study_to_yaml(make_study()))
        provenance = session_provenance(make_study(), "inprocess", "boundary")
        journals.append(Journal(tmp_path / name / "journal.sqlite", provenance))
        return journals[-1]

    yield begin
    for journal in journals:
        journal.close()


def test_each_trial_of_a_run_in_progress_shows(tmp_path, in_progress, make_trial):
    """SQLite keeps them beside the journal until that is closed."""
    journal = in_progress("run")
    runs = Runs(tmp_path, "run")
    assert "No result yet: 0 of 5 trials" in runs.listing()
    for number in range(2):
        trial = make_trial(number, {"gain": 0.5}, [1.0])
        for evaluation in trial.evaluations:
            journal.record_evaluation(evaluation)
        journal.record_trial(trial)
        assert f"No result yet: {number + 1} of 5 trials" in runs.listing()


def test_a_run_in_progress_is_as_late_as_its_latest_trial(tmp_path, in_progress):
    for name, journal, log in (("first", 1000, 3000), ("second", 2000, 2000)):
        in_progress(name)
        os.utime(tmp_path / name / "journal.sqlite", (journal, journal))
        os.utime(tmp_path / name / "journal.sqlite-wal", (log, log))
    assert Runs(tmp_path, "first").names() == ["first", "second"]
