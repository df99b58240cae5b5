"""The table at the end: everything in it, on narrow terminals too."""

import io

import pytest
from rich.console import Console

from bo_tuner.monitoring.display import comparison
from bo_tuner.study.study_file import load_study
from bo_tuner.tuning.limits import Sample
from bo_tuner.tuning.validation import Validation


def console(width=80):
    return Console(file=io.StringIO(), width=width, markup=False, emoji=False, highlight=False)


def text(of):
    return of.file.getvalue()


def validation(study, objective=0.1695, failures=0):
    samples = {
        name: Sample(name, worst=0.1226, count=25, violations=2, holds=False)
        for name in study.constraints
    }
    return Validation(
        parameters=study.search_space().defaults,
        draws=25,
        failures=failures,
        objective=objective,
        deviation=0.05,
        constraints=samples,
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
        # No line was wrapped or truncated.
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
