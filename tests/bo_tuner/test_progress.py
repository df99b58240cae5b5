"""What a run shows: a bar on a terminal, plain lines in a file, the same words in both."""

import dataclasses
import io
import re

import pytest
from rich.console import Console

from bo_tuner.progress import RunProgress, comparison, describe
from bo_tuner.recommendation import Candidate
from bo_tuner.study_file import load_study
from bo_tuner.validation import ConstraintCheck, Validation

ESCAPE = re.compile(r"\x1b\[[0-9;?]*[a-zA-Z]")


def console(terminal=False, width=80):
    return Console(
        file=io.StringIO(),
        force_terminal=terminal,
        width=width,
        markup=False,
        emoji=False,
        highlight=False,
    )


def text(of):
    return of.file.getvalue()


def candidate(trial, feasibility=0.9):
    return Candidate(
        trial=trial, objective=0.25, feasibility=feasibility, violation=0.1, penalty=0.0, score=0.0
    )


def follow(console, study, trials, best):
    with RunProgress(console, study) as progress:
        progress.begin("tuning", 5)
        for trial in trials:
            progress.trial(trial, best)


class TestLines:
    def test_a_file_gets_one_line_for_each_trial(self, make_study, make_trial):
        out = console()
        trials = [make_trial(k, {"gain": 0.5}, [1.0, 2.0]) for k in range(3)]
        follow(out, make_study(), trials, candidate(trials[0]))
        lines = text(out).splitlines()
        assert len(lines) == 3
        assert lines[2] == ("trial   2  gain 0.5  error 1.5  worst peak 0.5 (within 1)  [2 cuts]")
        assert not ESCAPE.search(text(out))

    def test_a_failure_has_all_that_repeats_it(self, make_study, make_trial):
        line = describe(make_trial(7, {"gain": 0.5}), make_study())
        assert line == "gain 0.5  FAILED: axis: stalled (context load 1.500; seed 0)"

    def test_a_violation_is_named(self, make_study, make_trial):
        line = describe(make_trial(7, {"gain": 0.5}, [1.0], worst=1.25), make_study())
        assert "worst peak 1.25 (above 1)" in line

    def test_brackets_of_a_reason_are_no_markup(self, make_study, make_trial):
        reason = "[/tmp/axis] says [bold]no[/] :warning:"
        trial = dataclasses.replace(make_trial(0, {"gain": 0.5}), reason=reason, warnings=("[/]",))
        for terminal in (False, True):
            out = console(terminal, 200)
            follow(out, make_study(), [trial], None)
            assert reason in ESCAPE.sub("", text(out))
            assert "warning: [/]" in ESCAPE.sub("", text(out))

    def test_long_lines_are_not_broken_in_a_file(self, make_study, make_trial):
        out = console(width=40)
        follow(out, make_study(), [make_trial(0, {"gain": 0.5}, [1.0])], None)
        assert len(text(out).splitlines()) == 1


class TestTerminal:
    @pytest.mark.parametrize("width", [40, 80, 200])
    def test_shows_count_and_incumbent(self, make_study, make_trial, width):
        out = console(True, width)
        trial = make_trial(3, {"gain": 0.5}, [1.0])
        follow(out, make_study(), [trial], candidate(trial))
        shown = ESCAPE.sub("", text(out))
        assert "1/5" in shown
        if width >= 200:
            assert "incumbent: trial 3, error 0.25" in shown
            assert "P(feasible) 0.90" in shown

    def test_the_validation_has_a_bar_of_its_own(self, make_study):
        out = console(True)
        with RunProgress(out, make_study()) as progress:
            progress.begin("tuning", 5)
            progress.begin("validation", 3)
            progress.advance()
        last = ESCAPE.sub("", text(out)).split("\r")[-1]
        assert "validation" in last
        assert "1/3" in last
        assert "tuning" not in last

    @pytest.mark.parametrize("width", [40, 80])
    def test_the_bar_fits_its_line(self, make_study, make_trial, width):
        """A bar that wraps would leave a trail of old ones on the screen."""
        out = console(True, width)
        trial = make_trial(3, {"gain": 0.5}, [1.0])
        follow(out, make_study(), [trial], candidate(trial, feasibility=0.1))
        bars = [line for line in ESCAPE.sub("", text(out)).splitlines() if "1/5" in line]
        assert bars
        assert all(len(part) <= width for line in bars for part in line.split("\r"))

    def test_no_incumbent_yet(self, make_study, make_trial):
        trial = make_trial(0, {"gain": 0.5})
        out = console(True, 200)
        follow(out, make_study(), [trial], None)
        assert "no complete trial yet" in ESCAPE.sub("", text(out))

    def test_no_feasible_incumbent(self, make_study, make_trial):
        trial = make_trial(4, {"gain": 0.5}, [1.0])
        out = console(True, 200)
        follow(out, make_study(), [trial], candidate(trial, feasibility=0.1))
        assert "no feasible point yet (least violating: trial 4)" in ESCAPE.sub("", text(out))

    def test_a_fault_puts_the_terminal_back(self, make_study):
        out = console(True)

        def fail():
            with RunProgress(out, make_study()) as progress:
                progress.begin("tuning", 5)
                raise ZeroDivisionError

        with pytest.raises(ZeroDivisionError):
            fail()
        shown = text(out)
        # The cursor, hidden for the bar, is shown again.
        assert shown.rindex("\x1b[?25h") > shown.rindex("\x1b[?25l")


def validation(study, objective=0.1695, failures=0):
    checks = [
        ConstraintCheck(name, worst=0.1226, violations=2, holds=False) for name in study.constraints
    ]
    return Validation(
        parameters=study.search_space().defaults,
        draws=25,
        failures=failures,
        objective=objective,
        deviation=0.05,
        constraints=tuple(checks),
    )


class TestTable:
    @pytest.mark.parametrize("name", ["benchmark", "full"])
    def test_fits_80_columns(self, name):
        study = load_study(name)
        out = console()
        out.print(comparison(study, validation(study), validation(study)))
        lines = text(out).splitlines()
        assert max(map(len, lines)) <= 80
        shown = text(out)
        for word in ("control_horizon", "tracking_error", "overshoot", "draws above 0.09", "m/s"):
            assert word in shown
        # Nothing was broken over two lines or cut off.
        assert "…" not in shown
        assert all("│" in line for line in lines[4:-1] if "─" not in line)
        first_cells = [line.split("│")[1].strip() for line in lines if line.startswith("│")]
        assert all(first_cells)

    def test_narrow_terminals_still_get_all_numbers(self):
        study = load_study("benchmark")
        out = console(width=40)
        out.print(comparison(study, validation(study), validation(study)))
        assert max(map(len, text(out).splitlines())) <= 40

    def test_the_mean_has_its_standard_error(self):
        study = load_study("benchmark")
        out = console()
        out.print(comparison(study, validation(study), validation(study)))
        # 0.05 / sqrt(25) = 0.01
        assert "0.1695 ± 0.01" in text(out)
        assert text(out).count("NO") == 2
