"""A run that was cut short anywhere goes on as if nothing had been, in process bit for bit."""

import json
import os
import shutil
import signal
import sqlite3
import struct
from dataclasses import replace

import pytest
from command_runs import RESULTS, noisy_runs
from commands import finish, run
from waiting import wait_until

from bo_tuner.cli import tune
from bo_tuner.errors import OutputError
from bo_tuner.recording.retention import Policy, RecordOptions
from bo_tuner.report.analysis import Analysis
from bo_tuner.report.sections.convergence import incumbents
from bo_tuner.storage.journal import create_journal
from bo_tuner.storage.journal_reader import read_journal
from bo_tuner.storage.record import read_run
from bo_tuner.storage.run_folder import RunFolder
from bo_tuner.storage.session_options import SessionOptions
from bo_tuner.study.study_file import load_study
from bo_tuner.trials import CHECKS, EvaluationState, Outcome, Stage, TrialState
from bo_tuner.tuning.summary import summary_from_record, with_summary


@pytest.fixture(scope="module")
def runs(tmp_path_factory, make_study):
    return noisy_runs(tmp_path_factory.mktemp("runs"), make_study, "counting_axis")


@pytest.fixture(scope="module")
def whole(runs):
    """A run that nothing disturbed."""
    code, _, err = runs.begin("whole")
    assert code == 0, err
    return "whole"


@pytest.fixture
def copy(runs, whole, request):
    """Name of a copy of that run, which may be changed."""
    name = request.node.name.translate(str.maketrans("[]./-", "-----"))
    runs.copy(whole, name)
    return name


class TestResume:
    @pytest.mark.parametrize("moment", [0.02, 0.45, 0.7, 1.0])
    def test_after_a_kill_the_run_is_the_same_to_the_last_bit(self, runs, whole, moment):
        evaluations = runs.evaluations(whole)
        kill = max(1, round(moment * evaluations))
        name = f"killed-{kill}"
        code, _, _ = runs.begin(name, kill=kill)
        assert code == -signal.SIGKILL
        code, _, err = runs.resume(name)
        assert code == 0, err
        assert runs.results(name) == runs.results(whole)
        # Only the evaluation that was running is run twice.
        assert runs.evaluations(name) == evaluations + 1

    def test_kills_one_after_the_other(self, runs, whole):
        code, _, _ = runs.begin("often", kill=3)
        for kill in (7, 12, 20):
            assert code == -signal.SIGKILL
            code, _, _ = runs.resume("often", kill=kill)
        code, _, err = runs.resume("often")
        assert code == 0, err
        assert runs.results("often") == runs.results(whole)
        assert runs.evaluations("often") == runs.evaluations(whole) + 4
        sessions = read_journal(runs.latest("often") / "journal.sqlite").sessions
        assert len({session["process"] for session in sessions}) == 5

    def test_a_run_that_has_ended_is_told_again(self, runs, whole):
        runs.copy(whole, "again")
        code, out, _ = runs.resume("again")
        assert code == 0
        assert "; no limit broken in" in out
        assert runs.results("again") == runs.results(whole)
        assert not (runs.folder / "again.evaluations").exists()

    @pytest.mark.parametrize(
        ("arguments", "complaint"),
        [
            (["--resume", "nowhere"], "nowhere: no such run folder"),
            (["--resume", "."], "no run folder: it has no study.yaml"),
            (["--resume", "whole/latest", "--seed", "3"], "--resume takes --seed from the run's"),
            (["--resume", "whole/latest", "--study", "full"], "--resume takes --study from"),
            (["--resume", "whole/latest", "--attach"], "--attach needs --backend ros"),
        ],
    )
    def test_refusals(self, runs, whole, arguments, complaint):
        code, out, err = runs.run("refused", *arguments)
        assert (code, out) == (2, "")
        assert complaint in err
        assert err.startswith("error: ")
        assert err.count("\n") == 1

    @pytest.mark.parametrize(
        ("arguments", "expected"),
        [
            ([], RecordOptions(Policy.ALL, 5_000_000)),
            (["--record", "none", "--record-limit", "7"], RecordOptions(Policy.NONE, 7_000_000)),
        ],
    )
    def test_bags_are_kept_as_before(self, runs, whole, arguments, expected):
        """A lower limit would delete those of the earlier session."""
        record = read_run(runs.latest(whole))
        assert (record.options.record, record.options.record_limit) == ("notable", 1_000_000_000)
        given = tune.make_parser().parse_args(["--resume", "run", *arguments])
        other = replace(record, options=SessionOptions(record="all", record_limit=5_000_000))
        assert tune._recording(given, other) == expected
        unknown = replace(record, options=SessionOptions())
        assert tune._recording(given, unknown) == (expected if arguments else RecordOptions())

    def test_a_folder_in_use_is_refused(self, runs, whole):
        folder = RunFolder(runs.latest(whole).resolve())
        try:
            code, _, err = runs.resume(whole)
            assert code == 2
            assert f"another process is using this run folder (process {os.getpid()})" in err
            with pytest.raises(OutputError, match="this process is using this run folder already"):
                RunFolder(folder.path)
        finally:
            folder.close()
        RunFolder(folder.path).close()


class TestStudyOnRecord:
    @pytest.mark.parametrize("command", ["tune", "validate", "report", "replay", "apply"])
    def test_a_changed_study_is_refused_with_what_changed(self, runs, copy, command):
        study = runs.latest(copy) / "study.yaml"
        text = study.read_text()
        assert text.count("upper: 1.0") == 1
        study.write_text(text.replace("upper: 1.0", "upper: 1.5"))
        arguments = ("--resume", runs.latest(copy)) if command == "tune" else (runs.latest(copy),)
        code, out, err = run(command, *arguments, folder=runs.folder)
        assert (code, out) == (2, "")
        (line,) = err.splitlines()
        assert "study.yaml: is not the study on record: constraints.peak.upper 1.0 -> 1.5" in line

    def test_comments_are_no_change(self, runs, copy):
        study = runs.latest(copy) / "study.yaml"
        study.write_text("# ours\n" + study.read_text())
        assert read_run(runs.latest(copy)).study.name == "function"

    def test_more_trials(self, runs, whole, copy):
        """The trials before stay as they are; the result is that of all."""
        folder = runs.latest(copy)
        code, _, err = runs.resume(copy, "--trials", 7)
        assert code in (0, 3), err
        before, after = read_run(runs.latest(whole)), read_run(folder)
        assert len(after.trials) == 7
        assert after.trials[:5] == before.trials
        assert after.evaluations[: len(before.evaluations)] == before.evaluations
        assert load_study(folder / "study.yaml") == after.study
        assert after.study == before.study.replace(trials=7)
        first, second = read_journal(folder / "journal.sqlite").sessions
        assert first["study_sha256"] == before.provenance["study_sha256"] != second["study_sha256"]
        assert without_verdict(after.summary) == summary_from_record(after)

    @pytest.mark.parametrize("kill", [3, 9, 14])
    def test_more_trials_know_the_repetitions_also_after_a_kill(self, runs, whole, copy, kill):
        before = read_run(runs.latest(whole))
        assert any(evaluation.stage in CHECKS for evaluation in before.evaluations)
        undisturbed = f"{copy}-undisturbed"
        runs.copy(whole, undisturbed)
        code, _, err = runs.resume(undisturbed, "--trials", 8)
        assert code in (0, 3), err
        expected = read_run(runs.latest(undisturbed))
        assert runs.resume(copy, "--trials", 8, kill=kill)[0] == -signal.SIGKILL
        assert runs.resume(copy)[0] == code
        found = read_run(runs.latest(copy))
        assert found.trials == expected.trials
        assert found.summary == expected.summary
        # None of them is run again.
        added = expected.evaluations[len(before.evaluations) :]
        repeated = {(e.trial, e.index) for e in before.evaluations if e.stage in CHECKS}
        assert repeated.isdisjoint((e.trial, e.index) for e in added)

    def test_more_trials_withdraw_the_earlier_result(self, runs, whole, copy):
        folder = runs.latest(copy)
        files = {*RESULTS, "report.html", "deploy/parameters.yaml", "deploy/provenance.json"}
        assert all((folder / name).exists() for name in files)
        assert runs.resume(copy, "--trials", 7, kill=1)[0] == -signal.SIGKILL
        left = {name for name in files if (folder / name).exists()}
        assert left == {"trials.csv", "evaluations.csv", "study.yaml"}
        # The nodes may have what is to be rolled back.
        assert [path.name for path in (folder / "deploy").iterdir()] == ["rollback.yaml"]
        code, _, err = runs.resume(copy)
        assert code in (0, 3), err
        assert all((folder / name).exists() for name in files)

    def test_the_report_of_a_continued_run_has_its_incumbents(self, runs, copy):
        code, out, err = runs.resume(copy, "--trials", 8, "--json-lines")
        assert code in (0, 3), err
        events = [json.loads(line) for line in out.splitlines()]
        told = {
            event["trial"]: event["incumbent"]
            for event in events
            if event["event"] == "trial" and not event["recalled"]
        }
        assert list(told) == [5, 6, 7]
        shown = dict(incumbents(Analysis(read_run(runs.latest(copy)))))
        for number, incumbent in told.items():
            assert shown[number].trial.number == incumbent["trial"]
            assert shown[number].objective == incumbent["objective"]
            assert shown[number].feasibility == incumbent["probability_feasible"]

    def test_a_kill_before_the_study_is_rewritten(self, runs, copy):
        """The session is on record first; its study is what counts."""
        folder = runs.latest(copy)
        old = (folder / "study.yaml").read_bytes()
        code, _, err = runs.resume(copy, "--trials", 6)
        assert code in (0, 3), err
        (folder / "study.yaml").write_bytes(old)
        assert read_run(folder).study.budget.trials == 6
        assert runs.resume(copy)[0] == code
        assert load_study(folder / "study.yaml").budget.trials == 6

    @pytest.mark.parametrize("trials", [5, 3, 0, -1])
    def test_fewer_trials(self, runs, copy, trials):
        code, out, err = runs.resume(copy, "--trials", trials)
        assert (code, out) == (2, "")
        assert f"--trials: expected more than the 5 of the run, found {trials}" in err

    def test_other_code(self, runs, copy):
        module = runs.folder / "counting_axis.py"
        text = module.read_text()
        try:
            module.write_text(text + "# newer\n")
            code, _, err = runs.resume(copy)
        finally:
            module.write_text(text)
        assert code == 0
        assert "the code of counting_axis has changed since the last session" in err
        first, second = read_journal(runs.latest(copy) / "journal.sqlite").sessions
        key = "sources_sha256.counting_axis"
        assert first[key] != second[key]


def without_verdict(summary):
    """Return a summary without what a certificate may change later."""
    return {key: value for key, value in summary.items() if key not in ("verdict", "feasible")}


class TestSummary:
    """Everything in it comes from the journal."""

    def test_is_the_same_from_the_record(self, runs, whole):
        record = read_run(runs.latest(whole))
        assert summary_from_record(record) == without_verdict(record.summary)

    @pytest.mark.parametrize(
        "change",
        [
            None,
            lambda summary: "{",
            lambda summary: "[" * 100_000,
            lambda summary: [summary],
            lambda summary: summary | {"trial": "1"},
            lambda summary: summary | {"trial": True},
            lambda summary: summary | {"trial": 10**400},
            lambda summary: summary | {"passed_check": "yes"},
            lambda summary: summary | {"evaluations": 1},
            lambda summary: summary | {"study_sha256": "0" * 64},
            lambda summary: summary | {"tuned": 7},
            lambda summary: summary | {"tuned": summary["default"]},
            lambda summary: summary | {"default": summary["default"] | {"draws": []}},
            lambda summary: summary | {"default": summary["default"] | {"constraints": {}}},
        ],
    )
    def test_one_that_is_none_is_made_anew(self, runs, whole, tmp_path, change):
        folder = shutil.copytree(runs.latest(whole).resolve(), tmp_path / "run")
        path, expected = folder / "summary.json", read_run(folder).summary
        if change is None:
            path.unlink()
        else:
            content = change(expected)
            path.write_text(content if isinstance(content, str) else json.dumps(content))
        told = []
        assert with_summary(read_run(folder), told.append).summary == without_verdict(expected)
        (line,) = told
        assert line.endswith("; made from the journal")

    def test_none_without_the_validation(self, runs, whole):
        record = read_run(runs.latest(whole))
        told = []
        unfinished = replace(record, evaluations=record.evaluations[:-1])
        assert with_summary(unfinished, told.append).summary is None
        assert "ignored, since the run has not ended" in told[0]


class TestLost:
    """What was lost with its nodes is run again once the run is resumed."""

    def lose(self, runs, whole, name, lost):
        """Copy a run as if some of its evaluations had been lost."""
        runs.copy(whole, name)
        folder = runs.latest(name).resolve()
        found = read_journal(folder / "journal.sqlite")
        gone = Outcome(EvaluationState.LOST, {}, "the node stopped")
        evaluations = [replace(e, outcome=gone) if lost(e) else e for e in found.evaluations]
        create_journal(folder / "journal.sqlite", found.sessions, evaluations, found.trials)
        return folder

    @pytest.mark.parametrize(
        ("stages", "index"), [((Stage.VALIDATION,), 3), ((Stage.VALIDATION,), 0), (CHECKS, None)]
    )
    def test_it_is_run_again(self, runs, whole, stages, index):
        if index is None:
            checks = (e for e in read_run(runs.latest(whole)).evaluations if e.stage in CHECKS)
            index = min(evaluation.index for evaluation in checks)
        name = f"lost-{stages[0]}-{index}"
        folder = self.lose(runs, whole, name, lambda e: e.stage in stages and e.index == index)
        before = read_run(folder)
        lost = sum(e.outcome.state is EvaluationState.LOST for e in before.evaluations)
        assert lost
        code, _, err = runs.resume(name)
        assert code == 0, err
        assert runs.evaluations(name) == lost
        found, expected = read_run(folder), read_run(runs.latest(whole))
        assert len(found.evaluations) == len(expected.evaluations) + lost
        sides = ("default", "tuned", "trial", "passed_check", "checked_trials")
        assert {k: found.summary[k] for k in sides} == {k: expected.summary[k] for k in sides}
        assert found.summary["verdict"] == expected.summary["verdict"]
        # A reader of the journal alone sees no more than the run did.
        assert summary_from_record(found) == without_verdict(found.summary)

    @pytest.mark.parametrize("trials", [1, 2])
    def test_trials_that_were_lost_last_are_run_again(self, runs, whole, trials):
        """As when the nodes are gone for good: the run ends, and goes on as if nothing had been."""
        complete = read_run(runs.latest(whole))
        begun = complete.trials[: trials + 2]
        gone = Outcome(EvaluationState.LOST, {}, "the node stopped")
        # In the second evaluation of a trial; the first one is not run again.
        lost = [
            replace(
                trial,
                state=TrialState.FAILED,
                reason=gone.reason,
                evaluations=(trial.evaluations[0], replace(trial.evaluations[1], outcome=gone)),
                worst_cases={},
            )
            for trial in begun[2:]
        ]
        known = [*begun[:2], *lost]
        name = f"lost-trials-{trials}"
        runs.copy(whole, name)
        journal = runs.latest(name).resolve() / "journal.sqlite"
        evaluations = [e for trial in known for e in trial.evaluations]
        create_journal(journal, read_journal(journal).sessions, evaluations, known)
        code, _, err = runs.resume(name)
        assert code == 0, err
        found = read_run(runs.latest(name))
        assert found.trials == complete.trials
        assert found.summary["tuned"] == complete.summary["tuned"]
        # What was lost is still on record, once.
        assert sum(e.outcome.unusable for e in found.evaluations) == trials
        assert runs.evaluations(name) == len(complete.evaluations) - len(evaluations) + trials

    def test_a_reader_counts_it_as_lost(self, runs, whole):
        folder = self.lose(
            runs, whole, "read", lambda e: (e.stage, e.trial, e.index) == (Stage.VALIDATION, 1, 2)
        )
        tuned = summary_from_record(read_run(folder))["tuned"]
        assert (tuned["failures"], tuned["lost"]) == (0, 1)

    def test_a_reader_does_not_take_the_draw_of_an_earlier_result_for_it(self, runs, whole):
        """As a run has it that was continued: another parameter set was validated before."""
        folder = self.lose(
            runs,
            whole,
            "earlier",
            lambda e: (e.stage, e.trial, e.index) == (Stage.VALIDATION, 1, 2),
        )
        record = read_run(folder)
        (lost,) = [e for e in record.evaluations if e.outcome.state is EvaluationState.LOST]
        (other,) = [
            e for e in record.evaluations if (e.stage, e.trial, e.index) == (Stage.VALIDATION, 0, 2)
        ]
        assert other.outcome.complete
        earlier = replace(other, trial=lost.trial, seed=lost.seed)
        record = replace(record, evaluations=(earlier, *record.evaluations))
        assert summary_from_record(record)["tuned"]["lost"] == 1


class TestDamage:
    def goes_on(self, runs, whole, name):
        code, _, err = runs.resume(name)
        assert code == 0, err
        assert runs.results(name) == runs.results(whole)
        assert "the record was damaged: " in err
        assert "everything before it is used" in err
        assert read_run(runs.latest(name)).damage == ""
        return err

    @pytest.mark.parametrize("part", [0.3, 0.9])
    def test_a_journal_cut_off(self, runs, whole, copy, part):
        journal = runs.latest(copy) / "journal.sqlite"
        pages = journal.stat().st_size // 4096
        os.truncate(journal, int(part * pages) * 4096)
        err = self.goes_on(runs, whole, copy)
        assert "kept as journal.damaged-1.sqlite" in err
        assert (runs.latest(copy) / "journal.damaged-1.sqlite").exists()

    def test_a_changed_byte_in_a_value(self, runs, whole, copy):
        journal = runs.latest(copy) / "journal.sqlite"
        content = journal.read_bytes()
        before = read_run(runs.latest(copy))
        seed = str(before.evaluations[20].outcome.metrics["error"]).encode()
        place = content.index(seed) + 5
        changed = content[:place] + bytes([content[place] ^ 1]) + content[place + 1 :]
        journal.write_bytes(changed)
        after = read_run(runs.latest(copy))
        assert after.damage == "journal.sqlite: evaluation 21 is damaged"
        assert after.evaluations == before.evaluations[:20]
        # As many trials as have all their evaluations.
        assert after.trials == before.trials[: len(after.trials)]
        assert sum(len(trial.evaluations) for trial in after.trials) <= 20
        self.goes_on(runs, whole, copy)

    def test_a_damaged_log_of_commits(self, runs, whole):
        """What a kill leaves is in SQLite's log; SQLite drops what comes after damage there."""
        code, _, _ = runs.begin("log", kill=25)
        assert code == -signal.SIGKILL
        log = runs.latest("log") / "journal.sqlite-wal"
        content = bytearray(log.read_bytes())
        (page,) = struct.unpack_from(">I", content, 8)
        place = 32 + (24 + page) * ((len(content) - 32) // (24 + page) // 2) + 100
        content[place] ^= 1
        log.write_bytes(content)
        assert "damaged after page" in self.goes_on(runs, whole, "log")

    def test_a_killed_writer_is_no_damage(self, runs):
        code, _, _ = runs.begin("no-damage", kill=25)
        assert code == -signal.SIGKILL
        code, _, err = runs.resume("no-damage")
        assert code == 0
        assert "damaged" not in err

    def test_a_trial_without_its_evaluations_is_not_taken(self, runs, whole, copy):
        journal = runs.latest(copy) / "journal.sqlite"
        database = sqlite3.connect(journal)
        database.execute("DELETE FROM evaluation WHERE trial = 2 AND position = 1")
        database.commit()
        database.close()
        record = read_run(runs.latest(copy))
        assert len(record.trials) == 2
        assert record.damage == "journal.sqlite: a trial lacks some of its test runs"

    @pytest.mark.parametrize("content", [b"", b"SQLite format 3\0", b"x" * 5000])
    def test_no_journal_at_all(self, runs, copy, content):
        (runs.latest(copy) / "journal.sqlite").write_bytes(content)
        code, _, err = runs.resume(copy)
        assert code == 2
        assert err.startswith("error: ")
        assert "journal.sqlite: " in err
        assert err.count("\n") == 1


class TestRecordOfARunInProgress:
    def test_is_a_prefix_of_what_it_will_be(self, runs, whole):
        new = ("--study", runs.study, "--backend", "inprocess", "--output", "progress")
        process = runs.start("progress", *new, hold=9)
        wait_until(lambda: runs.evaluations("progress") == 9, "its ninth evaluation", process)
        seen = [read_run(runs.latest("progress"))]
        assert len(seen[0].evaluations) == 8
        runs.go_on("progress")

        def ended():
            seen.append(read_run(runs.latest("progress")))
            return process.poll() is not None

        wait_until(ended, "its end")
        finish(process)
        final = read_run(runs.latest(whole))
        for record in seen:
            assert record.damage == ""
            assert record.trials == final.trials[: len(record.trials)]
            assert record.evaluations == final.evaluations[: len(record.evaluations)]
