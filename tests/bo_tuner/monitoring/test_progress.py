"""What a run shows: a bar on a terminal, plain lines in a file, the same words in both."""

import dataclasses
import itertools
import re

import pytest
from terminals import console

from bo_tuner.evidence.trial_row import TrialOutcome
from bo_tuner.methods.registry import METHODS
from bo_tuner.methods.stopping import StopAdvice
from bo_tuner.monitoring.progress import (
    RunProgress,
    advice_in_words,
    describe,
    duration,
)
from bo_tuner.monitoring.status import RunStatus
from bo_tuner.optimizers.ranking import Candidate
from bo_tuner.plans import Phase
from bo_tuner.run_notes import Notes, Unusable
from bo_tuner.study.limits import outcome_in_words
from bo_tuner.text import JOIN
from bo_tuner.trials import EvaluationState, Outcome

ESCAPE = re.compile(r"\x1b\[[0-9;?]*[a-zA-Z]")


def text(of):
    return of.file.getvalue()


def candidate(trial, feasibility=0.9):
    return Candidate(
        trial=trial, objective=0.25, feasibility=feasibility, violation=0.1, penalty=0.0, score=0.0
    )


def follow(console, study, trials, best):
    status = RunStatus(study, METHODS["IV"])
    with RunProgress(console, study, status) as progress:
        for observer in (status, progress):
            observer.begin(Phase.TUNING, 5)
        for trial in trials:
            for observer in (status, progress):
                for evaluation in trial.evaluations:
                    observer.evaluation(evaluation)
                observer.trial(trial, best)


class TestLines:
    def test_a_file_gets_one_line_for_each_trial(self, make_study, make_trial):
        out = console()
        trials = [make_trial(k, {"gain": 0.5}, [1.0, 2.0]) for k in range(3)]
        follow(out, make_study(), trials, candidate(trials[0]))
        lines = text(out).splitlines()
        assert lines[-1] == "    2       0.5       1.5        0.5"
        assert [line.split()[0] for line in lines[-3:]] == ["0", "1", "2"]
        assert not ESCAPE.search(text(out))

    def test_a_file_gets_a_line_now_and_then_where_nothing_else_is_said(
        self, make_study, make_trial
    ):
        """Steps of 12 s: the third one after a line is 36 s later."""
        seconds = itertools.count(0.0, 12.0)
        now = [next(seconds)]
        out = console()
        with RunProgress(out, make_study(), clock=lambda: now[0]) as progress:
            progress.begin("validation", 10)
            for _ in range(7):
                now[0] = next(seconds)
                progress.advance()
        assert text(out).splitlines() == ["validation: 3 of 10", "validation: 6 of 10"]

    def test_a_line_of_a_trial_is_progress_enough(self, make_study, make_trial):
        now = [0.0]
        out = console()
        with RunProgress(out, make_study(), clock=lambda: now[0]) as progress:
            progress.begin("tuning", 10)
            for number in range(3):
                now[0] += 20.0
                progress.trial(make_trial(number, {"gain": 0.5}, [1.0]), None)
        assert [line.split()[0] for line in text(out).splitlines()[-3:]] == ["0", "1", "2"]

    def test_a_run_whose_signals_have_gaps_is_told(self, make_study, make_trial):
        out = console()
        trial = make_trial(3, {"gain": 0.5}, [1.0, 2.0])
        whole, gap = trial.evaluations
        noted = gap.outcome.noted(remark="signal x was silent")
        gap = dataclasses.replace(gap, outcome=noted)
        marked = dataclasses.replace(trial, evaluations=(whole, gap))
        follow(out, make_study(), [marked], candidate(marked))
        first, *_ = text(out).splitlines()
        assert first.strip() == "warning: trial 3, test run 1: signal x was silent"

    def test_a_failure_has_all_that_repeats_it(self, make_study, make_trial):
        line = describe(make_trial(7, {"gain": 0.5}), make_study())
        assert (
            line.replace(JOIN, " ")
            == "gain 0.5        FAILED: axis: stalled (context load 1.500; seed 0)"
        )

    def test_a_failure_without_contexts(self, make_study, make_trial):
        trial = make_trial(7, {"gain": 0.5})
        (evaluation,) = trial.evaluations
        evaluation = dataclasses.replace(evaluation, context={})
        trial = dataclasses.replace(trial, evaluations=(evaluation,))
        line = describe(trial, make_study()).replace(JOIN, " ")
        assert line.endswith("FAILED: axis: stalled (context none; seed 0)")

    @pytest.mark.parametrize(
        ("outcome", "word"),
        [
            (Outcome(EvaluationState.LOST, {}, "gone"), "LOST"),
            (
                Outcome(EvaluationState.FAILED, reason="gone", notes=Notes(Unusable.DISTURBED)),
                "DISTURBED",
            ),
        ],
    )
    def test_what_was_not_its_own_failure(self, make_study, make_trial, outcome, word):
        """As the record has it; the report and the status use the same word."""
        trial = make_trial(7, {"gain": 0.5})
        evaluation = dataclasses.replace(trial.evaluations[0], outcome=outcome)
        trial = dataclasses.replace(trial, reason="gone", evaluations=(evaluation,))
        study = make_study()
        assert f"  {word}: gone (context load 1.500; seed 0)" in describe(trial, study).replace(
            JOIN, " "
        )
        assert outcome_in_words(study, trial) == outcome.ending == word.lower()
        assert TrialOutcome(trial.ending) == word.lower()

    def test_one_test_run(self, make_study, make_trial):
        line = describe(make_trial(7, {"gain": 0.5}, [1.0]), make_study())
        assert line.replace(JOIN, " ").endswith("  [1 test run]")

    def test_a_violation_is_named(self, make_study, make_trial):
        line = describe(make_trial(7, {"gain": 0.5}, [1.0], worst=1.25), make_study())
        assert "limit 1  over the limit (peak 1.25 > 1)" in line.replace(JOIN, " ")

    def test_a_new_best_is_marked(self, make_study, make_trial):
        out = console()
        trials = [make_trial(k, {"gain": 0.5}, [1.0]) for k in range(2)]
        follow(out, make_study(), trials, candidate(trials[1]))
        assert ["best so far" in line for line in text(out).splitlines()[-2:]] == [False, True]
        out = console()
        follow(out, make_study(), trials[1:], candidate(trials[1], feasibility=0.01))
        assert "best so far" not in text(out)

    def test_brackets_of_a_reason_are_no_markup(self, make_study, make_trial):
        reason = "[/tmp/axis] says [bold]no[/] :warning:"
        trial = dataclasses.replace(make_trial(0, {"gain": 0.5}), reason=reason, warnings=("[/]",))
        for terminal in (False, True):
            out = console(200, terminal=terminal)
            follow(out, make_study(), [trial], None)
            assert reason in ESCAPE.sub("", text(out))
            assert "warning: [/]" in ESCAPE.sub("", text(out))

    def test_long_lines_are_not_broken_in_a_file(self, make_study, make_trial):
        out = console(width=40)
        follow(out, make_study(), [make_trial(0, {"gain": 0.5}, [1.0])], None)
        assert len([line for line in text(out).splitlines() if "0.5" in line]) == 1


class TestTerminal:
    @pytest.mark.parametrize("width", [40, 80, 200])
    def test_shows_count_and_incumbent(self, make_study, make_trial, width):
        out = console(width, terminal=True)
        trial = make_trial(3, {"gain": 0.5}, [1.0])
        follow(out, make_study(), [trial], candidate(trial))
        shown = ESCAPE.sub("", text(out))
        assert "1/5" in shown
        words = "best within limits: trial 3, error 1, 90 % likely within limits"
        assert words in " ".join(shown.split())

    def test_shows_time_left_and_the_optimizer_s_share(self, make_study, make_trial):
        """Trials of 60 s in two runs and 20 s for the proposal: 20 / 80, and 2 of 5 are left."""
        out = console(80, terminal=True)
        trials = [make_trial(k, {"gain": 0.5}, [1.0, 1.0]) for k in range(3)]
        trials = [
            dataclasses.replace(
                trial,
                seconds=20.0,
                evaluations=tuple(
                    dataclasses.replace(evaluation, seconds=30.0)
                    for evaluation in trial.evaluations
                ),
            )
            for trial in trials
        ]
        follow(out, make_study(), trials, candidate(trials[0]))
        # 2 trials of 80 s, two checks of 20 runs, 40 s each with their part of proposals, and a
        # validation of 2 x 5 runs of 30 s.
        seconds = 2 * 80 + 40 * 40 + 10 * 30
        assert f"3/5 {duration(seconds)} left  optimizer 25%" in ESCAPE.sub("", text(out))

    def test_recorded_trials_are_counted_and_not_shown_again(self, make_study, make_trial):
        out = console(80, terminal=True)
        trials = [make_trial(k, {"gain": 0.5}, [1.0]) for k in range(3)]
        with RunProgress(out, make_study()) as progress:
            progress.begin(Phase.TUNING, 5)
            progress.recall(trials, candidate(trials[1]))
        shown = ESCAPE.sub("", text(out))
        assert "3/5" in shown
        assert "best within limits: trial 1" in shown
        assert "gain 0.5" not in shown

    def test_the_validation_has_a_bar_of_its_own(self, make_study):
        out = console(terminal=True)
        with RunProgress(out, make_study()) as progress:
            progress.begin("tuning", 5)
            progress.begin("validation", 3)
            progress.advance()
        last = ESCAPE.sub("", text(out)).split("\r")[-1]
        assert "validation" in last
        assert "1/3" in last
        assert "tuning" not in last

    @pytest.mark.parametrize("width", [20, 40, 80])
    def test_the_bar_fits_its_line(self, make_study, make_trial, width):
        """A bar that wraps would leave a trail of old ones on the screen."""
        out = console(width, terminal=True)
        trial = make_trial(3, {"gain": 0.5}, [1.0])
        follow(out, make_study(), [trial], candidate(trial, feasibility=0.1))
        shown = ESCAPE.sub("", text(out)).splitlines()
        bars = [line for line in shown if re.search(r"1/5|none yet", line)]
        assert len(bars) >= 2
        assert all(len(part) <= width for line in bars for part in line.split("\r"))

    def test_no_incumbent_yet(self, make_study, make_trial):
        trial = make_trial(0, {"gain": 0.5})
        out = console(200, terminal=True)
        follow(out, make_study(), [trial], None)
        assert "no complete trial yet" in ESCAPE.sub("", text(out))

    def test_no_feasible_incumbent(self, make_study, make_trial):
        trial = make_trial(4, {"gain": 0.5}, [1.0])
        out = console(200, terminal=True)
        follow(out, make_study(), [trial], candidate(trial, feasibility=0.1))
        # What its own test runs showed stands there whatever the models say of it.
        assert (
            "best within limits: none yet; closest: trial 4, kept all limits in its own test runs, "
            "10 % likely within limits"
        ) in ESCAPE.sub("", text(out))

    def test_a_fault_puts_the_terminal_back(self, make_study):
        out = console(terminal=True)

        def fail():
            with RunProgress(out, make_study()) as progress:
                progress.begin("tuning", 5)
                raise ZeroDivisionError

        with pytest.raises(ZeroDivisionError):
            fail()
        shown = text(out)
        # The cursor, hidden for the bar, is shown again.
        assert shown.rindex("\x1b[?25h") > shown.rindex("\x1b[?25l")


class TestWords:
    @pytest.mark.parametrize(
        ("seconds", "words"),
        [(0.4, "0:00:00"), (59.6, "0:01:00"), (100, "0:01:40"), (7265, "2:01:05")],
    )
    def test_duration(self, seconds, words):
        assert duration(seconds) == words

    def test_the_advice_has_its_numbers_with_units(self, make_study):
        study = make_study(
            metrics={"error": {"node": "axis", "unit": "m"}, "peak": {"node": "axis"}}
        )
        advice = StopAdvice(trials=20, remaining=10, expected_gain=0.00123, noise=0.0234)
        words = advice_in_words(advice, study)
        assert "the 10 remaining trials are expected to gain 0.0012 m in error" in words
        assert "at most" not in words
        assert "0.023 m" in words
