"""Ask and tell, and the tuning of a function: one journal, whoever runs the evaluations."""

import dataclasses
import gc
import math
import multiprocessing
import os
import re
import sqlite3
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from pathlib import Path

import pytest
import yaml
from in_process import complaint
from report_runs import axis_study, run_study

import bo_tuner as bt
from bo_tuner.cli import tune
from bo_tuner.storage.journal_reader import read_journal
from bo_tuner.trials import EvaluationState, TrialState

RESULTS = ("trials.csv", "evaluations.csv", "best.yaml", "summary.json")
RELATIVE = {"peak": {"kind": "worst_case", "metric": "peak", "upper": "1.1 * default"}}


def told(tuner, function, order=lambda waiting: 0):
    """Carry out a run; `order` chooses which of those that wait is told next."""
    waiting, asked = [], []
    while True:
        try:
            run = tuner.ask()
        except bt.WindowFull:
            run = waiting.pop(order(waiting))
            tuner.tell(run, function(run.parameters, run.context, run.seed))
            continue
        if run is None:
            return asked
        waiting.append(run)
        asked.append(run)


def evaluations_of(folder):
    content = read_journal(folder / "journal.sqlite")
    return content.trials, {(e.stage, e.trial, e.index): e for e in content.evaluations}


@pytest.fixture
def whole(make_function_study, function, tmp_path):
    """Folder of a run that nothing has disturbed."""
    make_function_study().optimize(function, tmp_path / "whole")
    return tmp_path / "whole"


class TestSameRun:
    @pytest.mark.parametrize("constraints", [None, RELATIVE], ids=["absolute", "relative"])
    def test_as_by_the_command_in_process(self, tmp_path, function, constraints):
        sections = {} if constraints is None else {"constraints": constraints}
        budget = axis_study()["budget"] | {"trials": 6}
        text = yaml.safe_dump(axis_study(budget=budget, **sections))
        by_command = run_study(tmp_path, text)
        study = bt.Study.from_yaml(tmp_path / "study.yaml")
        study.optimize(function, tmp_path / "optimized")
        with study.tuner(tmp_path / "told") as tuner:
            told(tuner, function)
        for folder in ("optimized", "told"):
            for name in RESULTS:
                expected = (by_command / name).read_bytes()
                assert (tmp_path / folder / name).read_bytes() == expected, name
            found = read_journal(tmp_path / folder / "journal.sqlite")
            expected = read_journal(by_command / "journal.sqlite")
            assert found.evaluations == expected.evaluations
            assert found.trials == expected.trials

    def test_in_whatever_order_results_come(self, make_function_study, function, tmp_path):
        orders = {"first": lambda waiting: 0, "last": lambda waiting: len(waiting) - 1}
        asked = {}
        for name, order in orders.items():
            with make_function_study(6).tuner(tmp_path / name, window=3) as tuner:
                asked[name] = told(tuner, function, order)
        first, last = (evaluations_of(tmp_path / name) for name in orders)
        assert first == last
        # They came in different orders indeed.
        assert asked["first"] != asked["last"]

    def test_after_the_process_died(self, make_function_study, function, tmp_path, whole):
        script = tmp_path / "dies.py"
        script.write_text(
            f"""
import os, sys
sys.path.insert(0, {str(Path(__file__).parent)!r})
import bo_tuner as bt
from conftest import response
calls = []
def dies(parameters, context, seed):
    calls.append(seed)
    if len(calls) == 9:
        os._exit(7)
    return response(parameters, context, seed)
bt.Study.from_yaml(sys.argv[1]).optimize(dies, sys.argv[2])
""",
            encoding="utf-8",
        )
        study = make_function_study()
        file, folder = tmp_path / "study.yaml", tmp_path / "run"
        file.write_text(study.to_yaml(), encoding="utf-8")
        done = subprocess.run([sys.executable, script, file, folder], check=False)
        assert done.returncode == 7
        assert len(read_journal(folder / "journal.sqlite").evaluations) == 8
        calls = []

        def counted(parameters, context, seed):
            calls.append(seed)
            return function(parameters, context, seed)

        study.optimize(counted, folder)
        content = read_journal(folder / "journal.sqlite")
        assert len(calls) == len(content.evaluations) - 8
        for name in RESULTS:
            assert (folder / name).read_bytes() == (whole / name).read_bytes(), name

    def test_what_was_not_told_is_asked_again(self, make_function_study, function, tmp_path):
        study = make_function_study(6)
        with study.tuner(tmp_path / "whole", window=3) as tuner:
            told(tuner, function)
        with study.tuner(tmp_path / "cut", window=3) as tuner:
            first, second, third = tuner.ask(), tuner.ask(), tuner.ask()
            tuner.tell(second, function(second.parameters, second.context, second.seed))
        # The window is that of the run, whatever is asked for now.
        with study.tuner(tmp_path / "cut") as tuner:
            again = [tuner.ask(), tuner.ask(), tuner.ask()]
            assert again[0] == first
            assert second not in again
            assert third in again
        with study.tuner(tmp_path / "cut") as tuner:
            told(tuner, function)
        assert evaluations_of(tmp_path / "cut") == evaluations_of(tmp_path / "whole")

    def test_a_run_that_is_over_has_its_result_again(self, make_function_study, whole, tmp_path):
        def uncalled(parameters, context, seed):
            raise AssertionError

        result = make_function_study().optimize(uncalled, whole)
        assert result.best == bt.load(whole).best

    def test_a_run_goes_on_to_more_trials(self, make_function_study, function, whole, tmp_path):
        make_function_study(6).optimize(function, whole)
        assert len(read_journal(whole / "journal.sqlite").trials) == 6


class TestAsking:
    @pytest.fixture
    def tuner(self, make_function_study, tmp_path):
        with make_function_study().tuner(tmp_path / "run") as tuner:
            yield tuner

    def test_no_more_than_the_window(self, tuner, function):
        run = tuner.ask()
        with pytest.raises(bt.WindowFull, match="tell a result first: 1 of 1"):
            tuner.ask()
        tuner.tell(run, function(run.parameters, run.context, run.seed))
        assert tuner.ask() != run

    def test_by_several_threads(self, make_function_study, function, tmp_path):
        """None of them has begun the run, and the answer is that of one."""
        with make_function_study().tuner(tmp_path / "run", window=3) as tuner:

            def carry_out(_):
                runs = 0
                while True:
                    try:
                        if (run := tuner.ask()) is None:
                            return runs
                    except bt.WindowFull:
                        time.sleep(0.001)
                        continue
                    tuner.tell(run, function(run.parameters, run.context, run.seed))
                    runs += 1

            with ThreadPoolExecutor(3) as threads:
                counts = list(threads.map(carry_out, range(3)))
        _, evaluations = evaluations_of(tmp_path / "run")
        assert sum(counts) == len(evaluations)
        alone = make_function_study().optimize(function, tmp_path / "alone", window=3)
        assert tuner.result().best == alone.best

    def test_telling_twice(self, tuner, function):
        run = tuner.ask()
        metrics = function(run.parameters, run.context, run.seed)
        tuner.tell(run, metrics)
        with pytest.raises(bt.UnknownRunError, match="trial 0, test run 0: told already"):
            tuner.tell(run, metrics)
        with pytest.raises(bt.UnknownRunError, match="trial 0, test run 0: told already"):
            tuner.fail(run, "late")

    def test_telling_of_another_run(self, tuner, make_function_study, tmp_path):
        tuner.ask()
        with make_function_study(seed=2).tuner(tmp_path / "other") as other:
            run = other.ask()
            with pytest.raises(bt.UnknownRunError, match="asked for by another tuner"):
                tuner.tell(run, {"error": 1.0, "peak": 1.0})
        with pytest.raises(bt.UnknownRunError, match="expected a run that was asked for, found 3"):
            tuner.tell(3, {"error": 1.0, "peak": 1.0})

    @pytest.mark.parametrize("what", ["parameters", "context", "seed"])
    def test_telling_of_a_run_that_was_changed(self, tuner, what):
        run = tuner.ask()
        other = {"parameters": {"gain": 0.25}, "context": {"load": 1.25}, "seed": run.seed + 1}
        changed = dataclasses.replace(run, **{what: other[what]})
        with pytest.raises(bt.UnknownRunError, match=f"0: {what} are not those that were asked"):
            tuner.tell(changed, {"error": 1.0, "peak": 1.0})
        tuner.tell(run, {"error": 1.0, "peak": 1.0})

    @pytest.mark.parametrize("forks", ["multiprocessing", "os"])
    def test_a_forked_child_tells_nothing(self, tuner, tmp_path, forks):
        run = tuner.ask()

        def tell():
            with tuner:
                with pytest.raises(bt.OutputError, match="this one was forked from it"):
                    tuner.tell(run, {"error": 1.0, "peak": 1.0})
                with pytest.raises(bt.OutputError, match="this one was forked from it"):
                    tuner.ask()

        if forks == "os":
            if (pid := os.fork()) == 0:
                code = 1
                try:
                    tell()
                    code = 0
                finally:
                    os._exit(code)
            assert os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]) == 0
        else:
            child = multiprocessing.get_context("fork").Process(target=tell)
            child.start()
            child.join()
            assert child.exitcode == 0
        assert evaluations_of(tmp_path / "run")[1] == {}
        with pytest.raises(bt.OutputError, match="this process is using"):
            bt.Study.from_yaml(tmp_path / "run" / "study.yaml").tuner(tmp_path / "run")
        tuner.tell(run, {"error": 1.0, "peak": 1.0})
        assert len(evaluations_of(tmp_path / "run")[1]) == 1

    def test_after_the_end(self, tuner, function):
        run = told(tuner, function)[-1]
        assert tuner.ask() is None
        with pytest.raises(bt.UnknownRunError, match="the run is over"):
            tuner.tell(run, {"error": 1.0, "peak": 1.0})
        assert tuner.result().best is not None

    def test_when_it_is_closed(self, tuner):
        run = tuner.ask()
        tuner.close()
        with pytest.raises(bt.RunError, match="the tuner is closed; open it again"):
            tuner.ask()
        with pytest.raises(bt.RunError, match="the tuner is closed; open it again"):
            tuner.tell(run, {"error": 1.0, "peak": 1.0})

    def test_a_lost_run_is_asked_for_again(self, tuner, function):
        run = tuner.ask()
        tuner.lose(run, "the bench was switched off")
        assert tuner.ask() == run
        tuner.tell(run, function(run.parameters, run.context, run.seed))
        first, second = read_journal(tuner.folder / "journal.sqlite").evaluations
        assert first.outcome.state is EvaluationState.LOST
        assert first.outcome.reason == "the bench was switched off"
        assert second.outcome.complete

    def test_three_lost_trials_end_the_session_and_not_the_run(
        self, tuner, make_function_study, function, whole
    ):
        def lose():
            while True:
                tuner.lose(tuner.ask(), "no bench")

        with pytest.raises(bt.RunError, match=r"3 trials in a row were lost .*: no bench"):
            lose()
        assert make_function_study().optimize(function, tuner.folder).best is not None

    def test_a_failed_run_fails_its_trial(self, tuner):
        run = tuner.ask()
        tuner.fail(run, "it fell over")
        following = tuner.ask()
        assert following.trial == run.trial + 1
        (trial,) = read_journal(tuner.folder / "journal.sqlite").trials
        assert (trial.state, trial.reason) == (TrialState.FAILED, "it fell over")


class TestMetrics:
    @pytest.fixture
    def tuner(self, make_function_study, tmp_path):
        with make_function_study().tuner(tmp_path / "run") as tuner:
            yield tuner

    @pytest.mark.parametrize(
        ("metrics", "said"),
        [
            ({"error": 1.0}, "metric peak is missing; expected a number for each of error, peak"),
            ({"error": 1.0, "peak": 1.0, "peek": 2.0}, "'peek' is no metric"),
            ({"error": 1.0, "peak": "1.0"}, "metric peak: expected a number, found text '1.0'"),
            ({"error": 1.0, "peak": True}, "metric peak: expected a number, found true"),
            ({"error": 1.0, "peak": None}, "metric peak: expected a number, found nothing"),
            ({"error": 1.0, "peak": [1.0]}, "metric peak: expected a number, found a list"),
            (1.0, "expected a number for each of error, peak, found 1.0"),
            (None, "expected a number for each of error, peak, found nothing"),
        ],
    )
    def test_what_is_no_result_is_refused_and_can_be_told_right(
        self, tuner, make_function_study, tmp_path, metrics, said
    ):
        run = tuner.ask()
        with pytest.raises(bt.MetricsError, match=said):
            tuner.tell(run, metrics)
        tuner.tell(run, {"error": 1.0, "peak": 0.5})
        (evaluation,) = read_journal(tuner.folder / "journal.sqlite").evaluations
        assert evaluation.outcome.metrics == {"error": 1.0, "peak": 0.5}
        with pytest.raises(bt.MetricsError, match=said):
            make_function_study().optimize(lambda *_: metrics, tmp_path / "optimized")

    @pytest.mark.parametrize(
        ("function", "found"),
        [
            (42, "found 42"),
            (lambda parameters: {}, "found one of (parameters): too many positional arguments"),
            (lambda p, c, s, more: {}, "missing a required argument: 'more'"),
        ],
    )
    def test_what_is_no_such_function_is_refused(
        self, make_function_study, tmp_path, function, found
    ):
        """Each of its runs would fail, as if for its parameters."""
        said = f"expected a function of parameters, context and seed.*{re.escape(found)}"
        for given in ({}, {"workers": 2}):
            with pytest.raises(bt.FunctionError, match=said):
                make_function_study().optimize(function, tmp_path / "run", **given)
        with pytest.raises(bt.FunctionError, match=said):
            bt.certify(function, make_function_study())
        assert not (tmp_path / "run").exists()

    @pytest.mark.parametrize("value", [math.nan, math.inf])
    def test_a_value_that_is_not_finite_is_a_failed_run(self, tuner, value):
        run = tuner.ask()
        tuner.tell(run, {"error": 1.0, "peak": value})
        (evaluation,) = read_journal(tuner.folder / "journal.sqlite").evaluations
        assert evaluation.outcome.state is EvaluationState.FAILED
        assert evaluation.outcome.reason == f"function: metric peak is {value}"

    @pytest.mark.parametrize(
        ("error", "reason"),
        [
            (bt.Failed("fell over"), "fell over"),
            (ZeroDivisionError("by zero"), "ZeroDivisionError: by zero"),
        ],
    )
    def test_an_exception_is_a_failed_run_with_its_reason(
        self, make_function_study, function, tmp_path, error, reason
    ):
        def fails(parameters, context, seed):
            if parameters["gain"] > 0.45:
                raise error
            return function(parameters, context, seed)

        make_function_study().optimize(fails, tmp_path / "run")
        evaluations = read_journal(tmp_path / "run" / "journal.sqlite").evaluations
        failed = [e for e in evaluations if e.parameters["gain"] > 0.45]
        assert failed
        assert {e.outcome.reason for e in failed} == {reason}
        assert all(e.outcome.complete for e in evaluations if e not in failed)

    def test_ctrl_c_ends_the_session_and_not_the_run(
        self, make_function_study, function, tmp_path, whole
    ):
        calls = []

        def interrupted(parameters, context, seed):
            calls.append(seed)
            if len(calls) == 5:
                raise KeyboardInterrupt
            return function(parameters, context, seed)

        study = make_function_study()
        with pytest.raises(KeyboardInterrupt):
            study.optimize(interrupted, tmp_path / "run")
        study.optimize(function, tmp_path / "run")
        for name in RESULTS:
            assert (tmp_path / "run" / name).read_bytes() == (whole / name).read_bytes(), name


class TestFolder:
    def test_one_process_at_a_time(self, make_function_study, tmp_path):
        study = make_function_study()
        refused = pytest.raises(bt.OutputError, match=r"this process is using .* tuner\.close")
        with study.tuner(tmp_path / "run"), refused:
            study.tuner(tmp_path / "run")
        study.tuner(tmp_path / "run").close()

    def test_one_that_nobody_has_any_more(self, make_function_study, tmp_path):
        study = make_function_study()
        study.tuner(tmp_path / "run").ask()
        gc.collect()
        study.tuner(tmp_path / "run").close()

    def test_processes_that_were_forked_meanwhile_do_not_hold_it(
        self, make_function_study, tmp_path
    ):
        study = make_function_study()
        with study.tuner(tmp_path / "run"):
            child = multiprocessing.get_context("fork").Process(target=time.sleep, args=(1000.0,))
            child.start()
        try:
            study.tuner(tmp_path / "run").close()
        finally:
            child.kill()
            child.join()

    def test_a_study_that_has_changed(self, make_function_study, whole):
        other = {"peak": bt.WorstCase("peak", upper=0.5)}
        with pytest.raises(bt.RunRecordError, match=r"another study: constraints\.peak\.upper"):
            make_function_study(constraints=other).tuner(whole)
        with pytest.raises(bt.RunRecordError, match=r"another study: budget\.trials 4 -> 3"):
            make_function_study(3).tuner(whole)

    def test_another_algorithm(self, make_function_study, whole):
        with pytest.raises(bt.RunRecordError, match="is of the algorithm boundary, not IV"):
            make_function_study().tuner(whole, algorithm="IV")
        with pytest.raises(bt.StudyError, match="algorithm: unknown 'magic'; expected one of"):
            make_function_study().tuner(whole, algorithm="magic")

    def test_something_else_in_it(self, make_function_study, tmp_path):
        (tmp_path / "thesis.tex").touch()
        with pytest.raises(bt.RunRecordError, match="is no run folder"):
            make_function_study().tuner(tmp_path)

    def test_a_run_on_nodes(self, tuned, make_function_study):
        with pytest.raises(bt.RunRecordError, match=r"run on inprocess, .* continue it with tune"):
            make_function_study().tuner(tuned.path)

    def test_commands_do_not_go_on_with_it(self, whole, capsys):
        said = complaint(tune, capsys, "--resume", whole)
        assert "is a run of a Python function" in said

    def test_a_damaged_record_is_told_of(self, make_function_study, function, whole):
        expected = bt.load(whole).best
        with closing(sqlite3.connect(whole / "journal.sqlite")) as db, db:
            db.execute("UPDATE evaluation SET seconds = seconds + 1.0 WHERE rowid = 9")
        with pytest.warns(RuntimeWarning, match="the record was damaged: journal.sqlite"):
            result = make_function_study().optimize(function, whole)
        assert result.best == expected

    def test_a_window_that_cannot_be(self, make_function_study, tmp_path):
        for window in (0, 1.5, "3"):
            with pytest.raises(bt.StudyError, match="window: expected"):
                make_function_study().tuner(tmp_path / "run", window=window)
        relative = make_function_study(constraints=RELATIVE)
        with pytest.raises(bt.StudyError, match="window: expected 1, since limits are relative"):
            relative.tuner(tmp_path / "run", window=2)
