"""The journal: what goes in comes out, survives a kill, and is refused with one line otherwise."""

import csv
import dataclasses
import os
import shutil
import signal
import sqlite3
import subprocess
import sys

import pytest
from hypothesis import given
from hypothesis import strategies as st

import bo_tuner.storage.journal
from bo_tuner.errors import JournalError, OutputError
from bo_tuner.metrics.collect import LARGEST_METRIC
from bo_tuner.plans import Event, EventKind, Phase
from bo_tuner.processor_load import Load
from bo_tuner.run_notes import Death, Messages, Notes, Published, Rate, Unusable
from bo_tuner.storage import journal as journal_module
from bo_tuner.storage.csv_tables import export_csv
from bo_tuner.storage.journal import SCHEMA_VERSION, Journal
from bo_tuner.storage.journal_reader import read_journal
from bo_tuner.trials import (
    TUNING,
    Evaluation,
    EvaluationState,
    Outcome,
    Stage,
    Trial,
    TrialState,
    WorstCase,
)

finite = st.floats(allow_nan=False, allow_infinity=False)
texts = st.text(max_size=20).filter(str.isprintable)
measured = st.floats(-LARGEST_METRIC, LARGEST_METRIC)
shares = st.none() | st.floats(0.0, 1.0)
names = st.sampled_from(["gain", "state", "reason", "trial", "größe"])


def evaluation(trial=0, index=0, stage=Stage.DRAWN, state=EvaluationState.COMPLETE, **values):
    outcome = Outcome(state, {"error": 0.1 + 0.2} if state == "complete" else {}, "", {})
    return dataclasses.replace(
        Evaluation(trial, index, stage, {"gain": 0.1 + 0.2}, {"load": 1.5}, 7, outcome),
        **values,
    )


def trial(number=0, evaluations=(), **values):
    plain = Trial(
        number, {"gain": 0.1 + 0.2}, "initial", TrialState.COMPLETE, evaluations=tuple(evaluations)
    )
    return dataclasses.replace(plain, **values)


def record(journal, *trials):
    for item in trials:
        for each in item.evaluations:
            journal.record_evaluation(each)
        journal.record_trial(item)


def rows(path):
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


NOTED = Notes(
    unusable=Unusable.DISTURBED,
    death=Death("pid", anyway=True),
    deaths=2,
    gap=0.75,
    cut_after=1.25,
    at_least={"peak": 0.1 + 0.2},
    default={"error": 1e-300},
    carried_from="/runs/1",
    as_set={"kp": 0.1 + 0.2, "mode": "fast"},
    errors={"peak": 1e-300},
    remark="signal é was silent",
    park_problem="no answer",
    starts=2,
    start_seconds=0.5,
    warm_ups=3,
    warm_up_seconds=1.5,
    rested_seconds=2.5,
    ramped_seconds=3.5,
    ignored_results=4,
    signals={"angle": Messages(5, 1, 2)},
    rates={"angle": Rate(5.0, 0.1, 0.2, 0.3, 1.0), "once": None},
    streams={"/left": Published(10, 1, 0.001, 0.002, 0.1)},
    played={"/imu": 3000},
    held={"pid.kp": 0.1, "pid.gains": "[1.0, 2.0]", "pid.on": True, "pid.n": 3},
)


class TestRoundTrip:
    @given(
        parameters=st.dictionaries(names, finite | st.integers(1 - 2**63, 2**63 - 1)),
        context=st.dictionaries(names, finite),
        metrics=st.dictionaries(names, measured),
        details=st.dictionaries(texts, texts),
        reason=texts,
        load=st.none() | st.builds(Load, shares, shares),
        worst=st.none() | st.builds(WorstCase, finite, st.dictionaries(names, finite), finite),
        warnings=st.lists(texts, max_size=2).map(tuple),
    )
    def test_bit_for_bit(
        self, tmp_path_factory, parameters, context, metrics, details, reason, load, worst, warnings
    ):
        whole = evaluation(
            context=context, outcome=Outcome(EvaluationState.COMPLETE, metrics, "", details, load)
        )
        broken = evaluation(index=1, outcome=Outcome(EvaluationState.FAILED, {}, reason, details))
        recorded = trial(
            evaluations=[whole, broken],
            parameters=parameters,
            state=TrialState.FAILED,
            reason=reason,
            worst_cases={} if worst is None else {"peak": worst},
            warnings=warnings,
        )
        path = tmp_path_factory.mktemp("journal") / "journal.sqlite"
        with Journal(path, {}) as journal:
            record(journal, recorded)
        found = read_journal(path).trials
        assert found == (recorded,)
        # Outcomes are compared without it.
        assert [e.outcome.load for e in found[0].evaluations] == [load, None]

    def test_notes_bit_for_bit(self, tmp_path):
        """All of them, and none that is as without."""
        assert not [name for name, value in vars(NOTED).items() if value == vars(Notes())[name]]
        written = [evaluation(outcome=Outcome(EvaluationState.FAILED, notes=NOTED)), evaluation()]
        with Journal(tmp_path / "j", {}) as journal:
            for item in written:
                journal.record_evaluation(item)
        assert [e.outcome for e in read_journal(tmp_path / "j").evaluations] == [
            item.outcome for item in written
        ]
        assert journal_module.evaluation_row(written[1])[-2] == "{}"

    @pytest.mark.parametrize(
        "load", ["1", "{}", '{"machine": 1.5, "nodes": null}', '{"machine": "0.5", "nodes": 0.5}']
    )
    def test_a_load_that_is_none_is_refused(self, tmp_path, load):
        path = tmp_path / "journal.sqlite"
        with Journal(path, {}) as journal:
            row = list(journal_module.evaluation_row(evaluation()))
            row[journal_module.COLUMNS["evaluation"].index("load")] = load
            journal._record("evaluation", tuple(row))
        with pytest.raises(JournalError, match=r"rows that this program does not write: load[.:]"):
            read_journal(path)

    @pytest.mark.parametrize("value", [float("inf"), float("nan"), "0.5 m", None])
    def test_a_metric_that_is_no_number_is_refused(self, tmp_path, value):
        outcome = Outcome(EvaluationState.COMPLETE, {"error": value}, "", {})
        path = tmp_path / "journal.sqlite"
        with Journal(path, {}) as journal:
            record(journal, trial(0, [evaluation(outcome=outcome)]))
        with pytest.raises(
            JournalError, match=r"metrics\.error: expected a (finite )?number, found"
        ):
            read_journal(path)

    @pytest.mark.parametrize("value", [2e90, -1e200])
    def test_a_metric_that_is_refused_today_makes_a_failed_trial(self, tmp_path, value):
        """An earlier version recorded whatever is a finite number."""
        outcome = Outcome(EvaluationState.COMPLETE, {"error": value}, "", {})
        diverged = trial(1, [evaluation(1, 0), evaluation(1, 1, outcome=outcome)],
                         worst_cases={"peak": WorstCase(1e300, {}, 1e300)})  # fmt: skip
        path = tmp_path / "journal.sqlite"
        with Journal(path, {}) as journal:
            record(journal, trial(0, [evaluation()]), diverged)
        content = read_journal(path)
        assert content.damage == ""
        first, second = content.trials
        assert first.state is TrialState.COMPLETE
        assert second.state is TrialState.FAILED
        assert second.reason.startswith("metric error is ")
        assert not second.worst_cases
        assert second.evaluations[1].outcome.metrics == {}
        assert second.evaluations[0] == evaluation(1, 0)

    def test_all_fields_of_a_worst_case(self, tmp_path):
        values = [
            {"load": 1.25} if field.name == "context" else 0.5 + k
            for k, field in enumerate(dataclasses.fields(WorstCase))
        ]
        recorded = trial(worst_cases={"peak": WorstCase(*values)})
        with Journal(tmp_path / "j", {}) as journal:
            record(journal, recorded)
            assert read_journal(tmp_path / "j").trials == (recorded,)

    def test_checks_and_validation_belong_to_no_trial(self, tmp_path):
        recorded = trial(
            evaluations=[evaluation(index=k, stage=stage) for k, stage in enumerate(TUNING)]
        )
        others = [stage for stage in Stage if stage not in TUNING]
        with Journal(tmp_path / "j", {}) as journal:
            record(journal, recorded)
            for stage in others:
                journal.record_evaluation(evaluation(stage=stage))
            assert read_journal(tmp_path / "j").trials == (recorded,)

    def test_what_came_from_outside(self, tmp_path):
        """Also half a character of what a guard says, as the record of a reason."""
        events = [
            Event("tuning", 3, EventKind.GUARD, "the guard: angle > 2"),
            Event("tuning", 3, EventKind.CONTINUE),
            Event(Phase.TUNING, 5, EventKind.FINISH),
        ]
        with Journal(tmp_path / "j", {}) as journal:
            for event in events:
                journal.record_event(event)
            journal.record_event(Event("tuning", 6, EventKind.GUARD, "\udcff"))
            *kept, last = read_journal(tmp_path / "j").events
        assert kept == events
        assert last.detail == "?"

    def test_order_is_that_of_the_numbers(self, tmp_path):
        with Journal(tmp_path / "j", {}) as journal:
            record(journal, trial(1, [evaluation(1)]), trial(0, [evaluation(0)]))
            assert [item.number for item in read_journal(tmp_path / "j").trials] == [0, 1]

    def test_each_session_leaves_its_provenance(self, tmp_path):
        sessions = ({"seed": "1", "host": "a"}, {"seed": "2"})
        for provenance in sessions:
            with Journal(tmp_path / "j", provenance):
                pass
        assert read_journal(tmp_path / "j").sessions == sessions


class TestDurability:
    def test_a_kill_loses_nothing_that_was_recorded(self, tmp_path):
        code = """if True:
            import os, signal, sys
            from pathlib import Path
            from bo_tuner.storage.journal import Journal
            from bo_tuner.trials import *
            journal = Journal(Path(sys.argv[1]), {"seed": "1"})
            outcome = Outcome(EvaluationState.COMPLETE, {"error": 1.5})
            for k in range(50):
                journal.record_evaluation(
                    Evaluation(0, k, Stage.DRAWN, {"gain": 1.0}, {}, k, outcome)
                )
            trial = Trial(0, {"gain": 1.0}, "", TrialState.COMPLETE, evaluations=(None,) * 50)
            journal.record_trial(trial)
            journal.record_evaluation(Evaluation(1, 0, Stage.DRAWN, {"gain": 2.0}, {}, 0, outcome))
            os.kill(os.getpid(), signal.SIGKILL)
        """
        path = tmp_path / "journal.sqlite"
        process = subprocess.run([sys.executable, "-c", code, path], env=os.environ, check=False)
        assert process.returncode == -signal.SIGKILL
        (found,) = read_journal(path).trials
        assert [each.seed for each in found.evaluations] == list(range(50))
        export_csv(path, tmp_path, dict)
        # The evaluation of the trial that was not finished is kept, too.
        assert [row["trial"] for row in rows(tmp_path / "evaluations.csv")] == ["0"] * 50 + ["1"]

    def test_a_journal_is_begun_whole_or_not_at_all(self, tmp_path, monkeypatch):
        path = tmp_path / "journal.sqlite"
        monkeypatch.setattr(bo_tuner.storage.journal, "checksum", lambda row: None)
        with pytest.raises(JournalError, match="NOT NULL"):
            Journal(path, {})
        assert list(tmp_path.iterdir()) == []

    # Ends the process before its n-th step on the file system, for each n in turn.
    KILLED_AT_EACH_STEP = """if True:
        import os, shutil, sys
        from pathlib import Path
        from bo_tuner.storage.journal import Journal
        from bo_tuner.storage.journal_reader import read_journal
        from bo_tuner.storage.journal_repair import salvage
        STEPS = {"open", "os.rename", "os.remove", "sqlite3.connect"}
        folder, again = Path(sys.argv[1]), Path(sys.argv[2])
        step = ended = 0
        while not ended:
            shutil.rmtree(again, ignore_errors=True)
            shutil.copytree(folder, again)
            path = again / "journal.sqlite"
            if (child := os.fork()) == 0:
                left = step
                def count(event, arguments):
                    global left
                    if event in STEPS and str(again) in str(arguments[0]):
                        left -= 1
                        if left < 0:
                            os._exit(9)
                sys.addaudithook(count)
                CHANGE
                os._exit(0)
            ended = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0
            CHECK
            step += 1
        print(step)
    """

    def steps(self, tmp_path, change, check):
        code = self.KILLED_AT_EACH_STEP.replace("CHANGE", change).replace("CHECK", check)
        command = [sys.executable, "-c", code, tmp_path / "run", tmp_path / "again"]
        return int(subprocess.run(command, check=True, capture_output=True, text=True).stdout)

    def test_killed_while_it_is_made(self, tmp_path):
        (tmp_path / "run").mkdir()
        made = "Journal(path, {'seed': '1'}).close()"
        assert self.steps(tmp_path, made, f"{made}; read_journal(path)") >= 5

    def test_killed_while_it_is_made_whole(self, tmp_path):
        path = tmp_path / "run" / "journal.sqlite"
        made = tmp_path / "made"
        made.mkdir()
        trials = [trial(number, [evaluation(number)]) for number in range(100)]
        with Journal(made / path.name, {"seed": "1"}, trials) as journal:
            # In the write-ahead log when its writer is killed.
            record(journal, trial(100, [evaluation(100)]))
            shutil.copytree(made, path.parent)
        data = path.read_bytes()
        # In a page that the log has no newer version of.
        place = data.index(b'{"error": 0.', len(data) // 2) + 12
        path.write_bytes(data[:place] + bytes([data[place] ^ 1]) + data[place + 1 :])
        expected = read_journal(path)
        assert path.with_name("journal.sqlite-wal").exists()
        assert expected.damage
        count = len(expected.evaluations)
        assert 10 < count < 100
        check = (
            f"found, _ = salvage(path); assert len(found.evaluations) == {count}, step; "
            "assert not read_journal(path).damage"
        )
        assert self.steps(tmp_path, "salvage(path)", check) >= 5


class TestRefusals:
    def refusal(self, path):
        with pytest.raises(JournalError) as caught:
            Journal(path, {})
        assert isinstance(caught.value, OSError)
        text = str(caught.value)
        assert text.startswith(f"{path}: ")
        assert "\n" not in text
        return text

    def test_no_database(self, tmp_path):
        path = tmp_path / "journal.sqlite"
        path.write_text("Not a database, but long enough to look at. " * 50)
        assert "not a database" in self.refusal(path)

    def test_other_version(self, tmp_path):
        path = tmp_path / "journal.sqlite"
        database = sqlite3.connect(path)
        database.execute(f"PRAGMA user_version = {SCHEMA_VERSION + 1}")
        database.close()
        assert f"version {SCHEMA_VERSION + 1}" in self.refusal(path)

    @pytest.mark.parametrize("path", ["missing/journal.sqlite", "."])
    def test_no_file_can_be_there(self, tmp_path, path):
        assert "unable to open" in self.refusal(tmp_path / path)

    def test_a_trial_is_recorded_once(self, tmp_path):
        with Journal(tmp_path / "j", {}) as journal:
            record(journal, trial())
            with pytest.raises(JournalError, match="number"):
                record(journal, trial())


class TestTables:
    def test_names_of_one_section_do_not_hide_those_of_another(self, tmp_path):
        outcome = Outcome(
            EvaluationState.COMPLETE, {"state": 1.0, "gain": 2.0}, "", {"axis.gain": "3"}
        )
        parameters = {"gain": 6.0, "reason": 7.0}
        context = {"state": 4.0, "seed": 5.0}
        recorded = trial(
            evaluations=[evaluation(parameters=parameters, context=context, outcome=outcome)],
            parameters=parameters,
            worst_cases={"peak": WorstCase(8.0, {"state": 4.0}, 9.0)},
        )
        with Journal(tmp_path / "j", {}) as journal:
            record(journal, recorded)
        export_csv(tmp_path / "j", tmp_path, dict)
        (of_evaluation,) = rows(tmp_path / "evaluations.csv")
        expected = {
            "state": "complete",
            "seed": "7",
            "metrics.state": "1.0",
            "metrics.gain": "2.0",
            "details.axis.gain": "3",
            "context.state": "4.0",
            "context.seed": "5.0",
            "parameters.gain": "6.0",
            "parameters.reason": "7.0",
        }
        assert expected.items() <= of_evaluation.items()
        (of_trial,) = rows(tmp_path / "trials.csv")
        assert of_trial["worst_cases.peak.value"] == "8.0"
        assert of_trial["parameters.gain"] == "6.0"

    def test_a_trial_has_the_means_of_its_draws_and_the_validation_its_sides(self, tmp_path):
        values = {Stage.DRAWN: (1.0, 2.0), Stage.SEARCH: (9.0,)}
        found = [
            evaluation(stage=stage, outcome=Outcome(EvaluationState.COMPLETE, {"error": value}))
            for stage, of_stage in values.items()
            for value in of_stage
        ]
        found = [dataclasses.replace(item, index=k) for k, item in enumerate(found)]
        with Journal(tmp_path / "j", {}) as journal:
            record(journal, trial(evaluations=found))
            for side in (0, 1):
                journal.record_evaluation(evaluation(side, stage=Stage.VALIDATION))
        export_csv(tmp_path / "j", tmp_path, dict)
        (of_trial,) = rows(tmp_path / "trials.csv")
        assert of_trial["mean.error"] == "1.5"
        assert [row["trial"] for row in rows(tmp_path / "evaluations.csv")] == [
            *("0", "0", "0"),
            *("default", "tuned"),
        ]

    def test_doubles_read_back_bit_for_bit(self, tmp_path):
        value = 0.1 + 0.2
        with Journal(tmp_path / "j", {}) as journal:
            record(journal, trial(evaluations=[evaluation()]))
        export_csv(tmp_path / "j", tmp_path, dict)
        assert float(rows(tmp_path / "evaluations.csv")[0]["metrics.error"]) == value

    def test_an_empty_journal_gives_tables_without_rows(self, tmp_path):
        with Journal(tmp_path / "j", {}):
            pass
        export_csv(tmp_path / "j", tmp_path, dict)
        assert (tmp_path / "trials.csv").read_text() == "number\n"
        assert (tmp_path / "evaluations.csv").read_text() == "trial\n"

    def test_a_table_that_cannot_be_written(self, tmp_path):
        (tmp_path / "trials.csv").mkdir()
        with Journal(tmp_path / "j", {}):
            pass
        with pytest.raises(OutputError, match=r"trials\.csv"):
            export_csv(tmp_path / "j", tmp_path, dict)
