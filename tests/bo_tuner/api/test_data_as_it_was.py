"""What was not asked for, was otherwise than asked for, was wrong, or comes later."""

import numpy as np
import pytest

import bo_tuner as bt
from bo_tuner.models.fitting import Fitting
from bo_tuner.plans import EventKind
from bo_tuner.storage.journal_reader import read_journal
from bo_tuner.storage.record import read_run
from bo_tuner.trials import Stage, TrialState
from bo_tuner.tuning.summary import summary_from_record


def journal(folder):
    return read_journal(folder / "journal.sqlite")


def proposals(folder):
    return [
        (trial.number, trial.parameters["gain"], trial.origin) for trial in journal(folder).trials
    ]


def carry_on(tuner, function, runs=None):
    """Answer so many runs, or all."""
    while runs != 0 and (run := tuner.ask()) is not None:
        tuner.tell(run, function(run.parameters, run.context, run.seed))
        runs = None if runs is None else runs - 1


class TestAdd:
    def test_it_is_a_trial_that_informs_the_next_proposal(
        self, make_function_study, function, tmp_path
    ):
        """As if it had been there before: it is told ahead of what nobody has been asked for."""
        study = make_function_study(6)
        with study.tuner(tmp_path / "run") as tuner:
            carry_on(tuner, function, 4)
            before = len(journal(tmp_path / "run").trials)
            tuner.add({"gain": 0.31}, {"load": 1.25}, function({"gain": 0.31}, {"load": 1.25}, 0))
            added = journal(tmp_path / "run").trials[before]
            assert (added.origin, added.parameters) == ("added", {"gain": 0.31})
            (evaluation,) = added.evaluations
            assert (evaluation.stage, evaluation.context) == (Stage.SEARCH, {"load": 1.25})
            assert set(added.worst_cases) == {"peak"}
            carry_on(tuner, function)
        assert len(journal(tmp_path / "run").trials) == 6
        # The one after it knows of it.
        alone = make_function_study(6)
        with alone.tuner(tmp_path / "alone") as tuner:
            carry_on(tuner, function)
        assert (
            proposals(tmp_path / "alone")[before + 2 :] != proposals(tmp_path / "run")[before + 3 :]
        )

    def test_while_a_run_is_waited_for(self, make_function_study, function, tmp_path):
        with make_function_study(5).tuner(tmp_path / "run") as tuner:
            run = tuner.ask()
            tuner.add({"gain": 0.2}, {}, {"error": 1.01, "peak": 0.6})
            assert not journal(tmp_path / "run").trials
            tuner.tell(run, function(run.parameters, run.context, run.seed))
            carry_on(tuner, function)
        origins = [trial.origin for trial in journal(tmp_path / "run").trials]
        assert (origins[:2], len(origins)) == (["default", "added"], 5)

    @pytest.mark.parametrize("ended_after", [1, 4, 7])
    def test_a_run_that_is_continued_is_the_same(
        self, make_function_study, function, tmp_path, ended_after
    ):
        """Also where a session ends before a run that was added has become a trial."""

        def added(tuner):
            tuner.add({"gain": 0.2}, {}, {"error": 1.01, "peak": 0.6})
            tuner.add({"gain": 0.9}, {"load": 2.0}, {}, failure="it fell over")

        folders = [tmp_path / "whole", tmp_path / "in pieces"]
        for folder in folders:
            tuner = make_function_study(7).tuner(folder)
            carry_on(tuner, function, ended_after - 1)
            run = tuner.ask()
            added(tuner)
            if folder == folders[1]:
                tuner.close()
                tuner = make_function_study(7).tuner(folder)
                run = tuner.ask()
            tuner.tell(run, function(run.parameters, run.context, run.seed))
            carry_on(tuner, function)
            tuner.close()
        whole, pieces = map(journal, folders)
        assert whole.trials == pieces.trials
        assert [trial.origin for trial in whole.trials].count("added") == 2
        # The result is that of the journal alone, too.
        record = read_run(folders[1])
        assert summary_from_record(record).items() <= record.summary.items()

    def test_several_at_once_are_waited_for(self, make_function_study, function, tmp_path):
        with make_function_study(8).tuner(tmp_path / "run", window=3) as tuner:
            runs = [tuner.ask() for _ in range(3)]
            tuner.add({"gain": 0.2}, {}, {"error": 1.01, "peak": 0.6})
            for run in reversed(runs):
                tuner.tell(run, function(run.parameters, run.context, run.seed))
            while True:
                try:
                    run = tuner.ask()
                except bt.WindowFull:
                    continue
                if run is None:
                    break
                tuner.tell(run, function(run.parameters, run.context, run.seed))
        origins = [trial.origin for trial in journal(tmp_path / "run").trials]
        assert origins.index("added") == 3

    @pytest.mark.parametrize(
        ("run", "error", "said"),
        [
            (({"gian": 0.5}, {}, {}), bt.StudyError, "gian: unknown; expected one of gain"),
            (({}, {"lode": 1.0}, {}), bt.StudyError, "lode: unknown; expected one of load"),
            (({}, {}, {"error": 1.0}), bt.MetricsError, "metric peak is missing"),
            (
                ({"gain": 7.0}, {}, {"error": 1.0, "peak": 1.0}),
                bt.StudyError,
                "parameters: outside the bounds of gain",
            ),
            (
                ({}, {}, {"error": 1.0, "peak": 1.0}, {"peak": 0.0}),
                bt.MetricsError,
                "errors.peak: expected a positive number, found 0",
            ),
            (
                ({}, {}, {"error": 1.0, "peak": 1.0}, {"peek": 1.0}),
                bt.MetricsError,
                "errors.peek: there is no metric 'peek'",
            ),
        ],
    )
    def test_what_is_none_of_the_study_is_refused(
        self, make_function_study, function, tmp_path, run, error, said
    ):
        with make_function_study().tuner(tmp_path / "run") as tuner:
            with pytest.raises(error, match=said):
                tuner.add(*run)
            # Nothing is on record, and the run goes on.
            carry_on(tuner, function)
        assert not journal(tmp_path / "run").events

    def test_after_the_trials(self, make_function_study, function, tmp_path):
        with make_function_study(3).tuner(tmp_path / "run") as tuner:
            while len(journal(tmp_path / "run").trials) < 3:
                carry_on(tuner, function, 1)
            with pytest.raises(bt.RunError, match="the trials have ended"):
                tuner.add({}, {}, {"error": 1.0, "peak": 1.0})
            with pytest.raises(bt.RunError, match="the trials have ended"):
                tuner.withdraw(0, "the wrong tool")


class TestWithdraw:
    def test_it_says_nothing_any_more(self, make_function_study, function, tmp_path):
        def lying(parameters, context, seed):
            # Far better than all others, within the limit: a sensor that was not plugged in.
            return {"error": 0.0, "peak": 0.0}

        with make_function_study(5).tuner(tmp_path / "run") as tuner:
            while not journal(tmp_path / "run").trials:
                carry_on(tuner, lying, 1)
            tuner.withdraw(0, "the sensor was not plugged in")
            (trial,) = journal(tmp_path / "run").trials
            assert (trial.state, trial.unusable) == (TrialState.FAILED, True)
            assert trial.reason == "withdrawn: the sensor was not plugged in"
            carry_on(tuner, function)
        # It does not count, and its parameter set is tried again as it is the first to try.
        found = journal(tmp_path / "run").trials
        assert sum(not trial.unusable for trial in found) == 5
        assert len(found) == 6
        assert found[1].parameters == found[0].parameters
        text = (tmp_path / "run" / "trials.csv").read_text()
        assert "withdrawn: the sensor was not plugged in" in text

    @pytest.mark.parametrize("number", [0, 3])
    def test_a_run_that_is_continued_is_the_same(
        self, make_function_study, function, tmp_path, number
    ):
        """The last trial is not run again because it was withdrawn."""
        folders = [tmp_path / "whole", tmp_path / "in pieces"]
        for folder in folders:
            tuner = make_function_study(6).tuner(folder)
            while len(journal(folder).trials) < 4:
                carry_on(tuner, function, 1)
            tuner.withdraw(number, "the wrong tool")
            if folder == folders[1]:
                tuner.close()
                tuner = make_function_study(6).tuner(folder)
            carry_on(tuner, function)
            tuner.close()
        whole, pieces = map(journal, folders)
        assert whole.trials == pieces.trials
        assert whole.trials[number].was_withdrawn

    def test_what_cannot_be_withdrawn(self, make_function_study, function, tmp_path):
        with make_function_study(5).tuner(tmp_path / "run") as tuner:
            with pytest.raises(bt.UnknownRunError, match=r"trial 0: has not ended; .*: none"):
                tuner.withdraw(0, "too early")
            while len(journal(tmp_path / "run").trials) < 2:
                carry_on(tuner, function, 1)
            for number in (2, -1, "1", True, 0.0):
                with pytest.raises(bt.UnknownRunError, match=r"has not ended; .*: 0 to 1"):
                    tuner.withdraw(number, "no such trial")
            tuner.withdraw(1, "the wrong tool")
            with pytest.raises(bt.UnknownRunError, match="trial 1: withdrawn: the wrong tool"):
                tuner.withdraw(1, "once more")
        kinds = [event.kind for event in journal(tmp_path / "run").events]
        assert kinds == [EventKind.WITHDRAW]


class TestAsSet:
    def test_the_models_take_what_was_set(self, make_function_study, function, tmp_path):
        """By a device that sets nine tenths of the gain, and says so."""
        with make_function_study().tuner(tmp_path / "run") as tuner:
            while (run := tuner.ask()) is not None:
                gain = 0.9 * run.parameters["gain"]
                metrics = function({"gain": gain}, run.context, run.seed)
                tuner.tell(run, metrics, parameters={"gain": gain})
        record = read_run(tmp_path / "run")
        fitting = Fitting(record.study, record.trials, np.random.default_rng(0), None)
        x, _, _ = fitting.joint_observations(record.trials, "error")
        asked = [e.parameters["gain"] for trial in record.trials for e in trial.evaluations]
        # The bounds are 0 and 1.
        assert x[:, 0] == pytest.approx(0.9 * np.array(asked))

    def test_what_the_study_does_not_permit(self, make_function_study, function, tmp_path):
        with make_function_study().tuner(tmp_path / "run") as tuner:
            run = tuner.ask()
            metrics = function(run.parameters, run.context, run.seed)
            for wrong in ({"gain": 1.5}, {"gian": 0.5}, {"gain": "high"}):
                with pytest.raises(bt.StudyError, match="parameters: "):
                    tuner.tell(run, metrics, parameters=wrong)
            tuner.tell(run, metrics, parameters={"gain": run.parameters["gain"]})
        (evaluation,) = journal(tmp_path / "run").evaluations
        assert evaluation.outcome.notes.as_set == {}


def test_a_parameter_that_is_not_active_is_refused(make_function_study, function, tmp_path):
    parameters = {
        "gain": bt.Double(0.0, 1.0, default=0.5),
        "lead": bt.Double(0.0, 1.0, default=0.5, when="gain > 0.8"),
    }
    said = r"^parameters\.lead: is there only when gain > 0\.8$"
    with make_function_study(parameters=parameters).tuner(tmp_path / "run") as tuner:
        run = tuner.ask()
        metrics = function(run.parameters, run.context, run.seed)
        with pytest.raises(bt.StudyError, match=said):
            tuner.tell(run, metrics, parameters={"lead": 0.1})
        with pytest.raises(bt.StudyError, match=said):
            tuner.add({"gain": 0.1, "lead": 0.1}, {}, metrics)
        tuner.add({"gain": 0.9, "lead": 0.1}, {}, metrics)
        tuner.tell(run, metrics)


class TestPart:
    def test_a_metric_that_comes_later(self, make_function_study, function, tmp_path):
        folders = [tmp_path / "at once", tmp_path / "later", tmp_path / "in another session"]
        for folder in folders:
            tuner = make_function_study().tuner(folder)
            while (run := tuner.ask()) is not None:
                metrics = function(run.parameters, run.context, run.seed)
                if folder != folders[0]:
                    tuner.tell(
                        run, {"error": metrics.pop("error")}, errors={"error": 0.1}, more=True
                    )
                if folder == folders[2]:
                    tuner.close()
                    tuner = make_function_study().tuner(folder)
                    run = tuner.ask()
                tuner.tell(run, metrics)
            tuner.close()
        at_once, later, another = map(journal, folders)
        assert later.trials == another.trials
        assert [e.outcome.metrics for e in at_once.evaluations] == [
            e.outcome.metrics for e in later.evaluations
        ]
        assert {tuple(e.outcome.notes.errors.items()) for e in later.evaluations} == {
            (("error", 0.1),)
        }

    def test_what_is_still_missing_is_named(self, make_function_study, tmp_path):
        with make_function_study().tuner(tmp_path / "run") as tuner:
            run = tuner.ask()
            tuner.tell(run, {"error": 1.0}, more=True)
            with pytest.raises(bt.MetricsError, match="metric peak is missing"):
                tuner.tell(run, {"error": 1.0})
            with pytest.raises(bt.MetricsError, match="'peek' is no metric"):
                tuner.tell(run, {"peek": 1.0}, more=True)
            tuner.tell(run, {"peak": 0.5})

    @pytest.mark.parametrize("sessions", [1, 2])
    def test_what_was_told_of_a_lost_run_is_of_no_other(
        self, make_function_study, function, tmp_path, sessions
    ):
        with make_function_study().tuner(tmp_path / "run") as tuner:
            run = tuner.ask()
            tuner.tell(run, {"error": 99.0}, parameters={"gain": 0.9}, more=True)
            tuner.lose(run, "the cable came off")
            if sessions == 2:
                tuner.close()
                tuner = make_function_study().tuner(tmp_path / "run")
            again = tuner.ask()
            assert again == run
            with pytest.raises(bt.MetricsError, match="metric error is missing"):
                tuner.tell(again, {"peak": 0.5})
            tuner.tell(again, function(run.parameters, run.context, run.seed))
            tuner.close()
        last = journal(tmp_path / "run").evaluations[-1].outcome
        assert (last.metrics["error"], last.notes.as_set) == (
            function(run.parameters, run.context, run.seed)["error"],
            {},
        )
