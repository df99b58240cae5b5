"""The table at the end: everything in it, on narrow terminals too."""

import dataclasses
from pathlib import Path

import pytest
from terminals import console

from bo_tuner.evidence.facts import Basis, Said
from bo_tuner.evidence.limit_verdict import by_certificate
from bo_tuner.evidence.observed import Observed
from bo_tuner.evidence.quantities import quantities
from bo_tuner.evidence.verdict import State, Verdict
from bo_tuner.evidence.words.terminal import (
    print_next_steps,
    print_verdict,
    verdict_notes,
    verdict_table,
)
from bo_tuner.evidence.words.verdict import sentences
from bo_tuner.monitoring import display
from bo_tuner.monitoring.display import say
from bo_tuner.study.study_file import load_study
from bo_tuner.terminal import print_line, print_table
from bo_tuner.text import with_unit


def text(of):
    return of.file.getvalue()


def verdict(study, draws=25):
    """A verdict on draws in which the tuned parameter set is better by 0.25, +- 0.1 in turn."""

    def drawn(shift):
        return {
            k: dict.fromkeys(study.metrics, 1.1226 + shift * (1.0 + 0.4 * (-1) ** k))
            for k in range(draws)
        }

    return Verdict(
        state=State.VALIDATED,
        trial=7,
        basis=Basis(25),
        quantities=quantities(
            study,
            Observed(drawn(0.0), draws),
            Observed(drawn(-0.25), draws),
            {},
            {
                name: by_certificate(study, limit, passed=True, draws=draws, violations=0)
                for name, limit in study.constraints.items()
            },
            {},
        ),
    )


@pytest.mark.parametrize("width", [40, 60, 80])
def test_what_a_command_says_is_broken_between_words(width, monkeypatch):
    out = console(width, terminal=True)
    monkeypatch.setattr(display, "plain_console", lambda: out)
    line = "stream on /joint_states: 100 messages a second, of which the study takes one in ten"
    say(line)
    lines = text(out).splitlines()
    assert max(map(len, lines)) <= width
    # Put together again it is the same, so that no word was broken.
    assert " ".join(" ".join(lines).split()) == line


class TestTable:
    @pytest.mark.parametrize("name", ["benchmark", "full"])
    def test_fits_80_columns(self, name):
        study = load_study(name)
        out = console()
        out.print(verdict_table(study, verdict(study), study.search_space().defaults))
        shown = text(out)
        lines = shown.splitlines()
        assert max(map(len, lines)) <= 80
        for word in (
            "control_horizon",
            "mean tracking_error",
            "largest overshoot",
            "0.09",
            "[m/s]",
        ):
            assert word in shown
        # No line was wrapped or truncated.
        assert "…" not in shown
        rows = [line for line in lines[2:] if line.strip() and set(line) != {"─"}]
        assert len(rows) == len(study.parameters) + len(verdict(study).quantities) + 1

    @pytest.mark.parametrize("terminal", [False, True])
    @pytest.mark.parametrize("name", ["benchmark", "full"])
    @pytest.mark.parametrize("width", [40, 60])
    def test_a_narrow_terminal_gets_every_name_and_number_whole(self, width, name, terminal):
        study = load_study(name)
        out = console(width, terminal=terminal)
        found = verdict(study)
        print_table(out, verdict_table(study, found, study.search_space().defaults))
        shown = text(out)
        assert max(map(len, shown.splitlines())) <= width
        assert "…" not in shown
        lines = [line.strip() for line in shown.splitlines()]
        for quantity in found.quantities:
            assert with_unit(quantity.label, quantity.unit) in lines
            default, tuned = quantity.values_in_words
            assert f"default {default}" in shown
            assert f"tuned {tuned}" in shown
        for parameter, item in study.parameters.items():
            assert with_unit(parameter, item.unit) in lines
            assert f"default {study.search_space().defaults[parameter]:g}" in shown

    @pytest.mark.parametrize("width", [60, 80, 120])
    def test_no_word_is_broken_on_a_terminal(self, width):
        study = load_study("benchmark")
        found = dataclasses.replace(
            verdict(study), reasons=(Said("overshoot: " + "a reason " * 20),)
        )
        shown, whole = console(width, terminal=True), console(10_000)
        for out in (shown, whole):
            for line in verdict_notes(found):
                print_line(out, line, "  ")
            for sentence in sentences(found):
                print_line(out, sentence, "  ")
        assert max(map(len, text(shown).splitlines())) <= width
        assert text(shown).split() == text(whole).split()

    def test_next_steps_on_a_narrow_terminal_keep_their_commands_whole(self):
        found = verdict(load_study("benchmark"))
        for width, together in ((60, False), (120, True)):
            out = console(width, terminal=True)
            print_next_steps(out, found, Path("runs/benchmark-20261122-113926"))
            lines = [line.strip() for line in text(out).splitlines()]
            assert max(map(len, lines)) <= width
            assert ("validate runs/benchmark-20261122-113926" in lines) is not together
        out = console(60)
        print_next_steps(out, found, Path("runs/a"))
        # What reads a pipe gets a step in each line, below the heading.
        assert len(text(out).splitlines()) == 1 + 3

    def test_a_difference_has_half_of_its_interval(self):
        study = load_study("benchmark")
        out = console()
        print_verdict(out, study, verdict(study, draws=2), study.search_space().defaults)
        # Of two pairs -0.35 and -0.15: t(0.975, 1) * 0.1414 / sqrt(2) = 1.27.
        assert "-0.25 ± 1.3" in text(out)
        assert "± is half the width of its 95 % confidence interval" in text(out)

    def test_a_single_draw_has_no_interval(self):
        study = load_study("benchmark")
        out = console()
        print_verdict(out, study, verdict(study, draws=1), study.search_space().defaults)
        assert "-0.35" in text(out)
        assert "nan" not in text(out)
        assert "inf" not in text(out)
