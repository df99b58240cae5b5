"""Labels of metrics and parameters: what screens say in place of names, which files keep."""

import csv
import io
import json
import re

import numpy as np
import pytest
from functions import NODE
from report_runs import sections
from rich.console import Console

from bo_tuner.evidence.at_bounds import at_bounds
from bo_tuner.evidence.words.effects import not_seen
from bo_tuner.evidence.words.terminal import print_verdict
from bo_tuner.evidence.words.verdict import at_bound
from bo_tuner.figures.keys import legend
from bo_tuner.monitoring.progress import describe, incumbent_in_words
from bo_tuner.monitoring.trial_table import TrialTable
from bo_tuner.report.analysis import Analysis
from bo_tuner.report.comparison import comparison
from bo_tuner.report.page import chapters, render
from bo_tuner.report.time_response import bounds_beside
from bo_tuner.report.trial_page import trial_sections
from bo_tuner.study.titles import mean_title
from bo_tuner.text import JOIN
from bo_tuner.tuning.effects import Effect, ParameterEffects

TITLES = {"gain": "Reach of the arm", "error": "Mean miss", "peak": "Bump"}


@pytest.fixture(scope="module")
def analysis(axis_run):
    """A run with a label for each name; its limit is called otherwise."""
    gain = NODE | {"type": "double", "bounds": [0.0, 1.0], "default": 0.5, "unit": "m"}
    return Analysis(
        axis_run(
            parameters={"gain": gain | {"label": TITLES["gain"]}},
            metrics={
                name: NODE | {"label": TITLES[name], "unit": "N"} for name in ("error", "peak")
            },
            constraints={"limit": {"kind": "worst_case", "metric": "peak", "upper": 1.0}},
        )
    )


def texts_of(parts):
    """What a reader sees of sections, but for the study itself and what stands in brackets."""
    for section in parts:
        if section.name == "provenance":
            continue
        yield from (section.title, section.lead, *section.notes)
        for table in section.tables:
            yield from (table.caption, *table.header, *(c for row in table.rows for c in row))
        for figure in section.figures:
            yield from (figure.title, figure.caption, figure.alternative)
            yield from (entry.name for entry in legend(figure))
            for panel in figure.panels:
                yield from (panel.title, panel.x.title, panel.y.title)
                for element in panel.elements:
                    yield from getattr(element, "hover", None) or ()


def named(texts, name):
    """Texts with a name, unless it stands in brackets behind its label."""
    return [text for text in texts if re.search(rf"(?<!\()\b{name}\b", text)]


def test_the_report_and_its_pages_of_trials(analysis):
    parts = [*sections(analysis), *trial_sections(analysis, analysis.trials[2])]
    texts = [*texts_of(parts), *texts_of(comparison({"a": analysis, "b": analysis}))]
    for name in TITLES:
        assert named(texts, name) == []
    for title in TITLES.values():
        assert any(title in text for text in texts)


def test_the_mean_of_what_is_called_a_mean(analysis):
    """No screen says "mean Mean miss"."""
    parts = [*sections(analysis), *trial_sections(analysis, analysis.trials[2])]
    texts = [*texts_of(parts), *texts_of(comparison({"a": analysis, "b": analysis}))]
    assert [text for text in texts if re.search(r"\bmean mean\b", text, re.IGNORECASE)] == []
    assert (mean_title("meander"), mean_title("mean")) == ("mean meander", "mean")
    assert mean_title("mean_error") == "mean_error"


def test_what_to_set_has_the_name_too(analysis):
    """By the label alone nobody could set it."""
    page = render(analysis, chapters(analysis))
    assert f"{TITLES['gain']} (gain) [m]" in page


def test_a_limit_is_called_by_its_label_in_a_legend(analysis):
    """At the lines of a response, which a trace has by the metric."""
    limits = bounds_beside(analysis.study, "peak", np.zeros(2), np.zeros(2))
    assert [limit.name for limit in limits] == [TITLES["peak"]]


def test_sentences_of_a_verdict(analysis):
    """On a result that is at a bound, with measured times that exceeded a limit."""
    study = analysis.study
    (bound,) = at_bounds(study, {"gain": 1.0})
    assert at_bound(bound).startswith(f"{TITLES['gain']} (gain) is at its upper bound 1 m")
    effect = ParameterEffects("gain", (Effect("peak", "N", False, 0.0, 0.1),), True)
    assert f"above 0.1 N on {TITLES['peak']} would" in not_seen(study, effect)


def test_the_terminal(analysis):
    study, out = analysis.study, Console(file=io.StringIO(), width=200)
    print_verdict(out, study, analysis.verdict, analysis.answer.parameters)
    lines = [
        *out.file.getvalue().splitlines(),
        describe(analysis.trials[2], study).replace(JOIN, " "),
        incumbent_in_words(analysis.leader, study),
        # Names are broken in a header.
        " ".join(line.plain for line in TrialTable(study, out).lines(analysis.trials[2], "")),
    ]
    for name in ("error", "peak"):
        assert named(lines, name) == []
    for title in TITLES.values():
        assert named(lines, re.escape(title).rstrip("\\)")) != []


def test_files_keep_the_names(analysis):
    folder = analysis.record.path
    summary = json.loads((folder / "summary.json").read_text())
    assert set(summary["default"]["parameters"]) == {"gain"}
    with (folder / "evaluations.csv").open() as file:
        header = " ".join(next(csv.reader(file)))
    assert "peak" in header
    assert TITLES["peak"] not in header
