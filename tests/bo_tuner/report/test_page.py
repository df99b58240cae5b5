"""The page: whole, on its own, true to the journal, and harmless."""

import base64
import dataclasses
import hashlib
import itertools
import json
import math
import re
import shlex
from dataclasses import replace
from html import unescape
from html.parser import HTMLParser

import pytest
from report_runs import with_ends

from bo_tuner.errors import OutputError, RunRecordError
from bo_tuner.figures.figure import Points
from bo_tuner.report.analysis import Analysis
from bo_tuner.report.marks import DEFAULT, OVER_LIMIT, RESULT
from bo_tuner.report.page import chapters, render, report_figures, write_report
from bo_tuner.report.sections.answer import answer
from bo_tuner.storage.record import read_run
from bo_tuner.trials import EvaluationState, Stage

# Elements without an end.
VOID = {"meta", "link", "img", "br", "input"}


ONE_OF_EACH = {
    "trials": 1,
    "initial_trials": 1,
    "drawn_contexts": 1,
    "search_evaluations": 1,
    "validation_draws": 1,
}
"""The smallest budget of a study."""


class Page(HTMLParser):
    """Elements of a page, scripts, tables by caption, and what is not balanced."""

    def __init__(self, text):
        super().__init__()
        self.elements, self.scripts, self.tables, self.open = [], [], {}, []
        self.caption = self.cell = None
        self.feed(text)
        assert self.open == []

    def handle_starttag(self, tag, attributes):
        self.elements.append((tag, dict(attributes)))
        if tag not in VOID:
            self.open.append(tag)
        if tag == "script":
            self.scripts.append((dict(attributes).get("type"), ""))
        elif tag == "caption":
            self.caption = ""
        elif tag == "tr":
            self.rows.append([])
        elif tag == "table":
            self.rows = []
        elif tag in ("td", "th"):
            self.cell = ""

    def handle_endtag(self, tag):
        assert self.open.pop() == tag
        if tag == "caption":
            self.tables[self.caption], self.caption = self.rows, None
        elif tag in ("td", "th"):
            self.rows[-1].append(self.cell.strip())
            self.cell = None

    def handle_data(self, data):
        if self.open and self.open[-1] == "script":
            kind, text = self.scripts[-1]
            self.scripts[-1] = kind, text + data
        elif self.caption is not None:
            self.caption += data
        elif self.cell is not None:
            self.cell += data


def page_of(record, folder):
    return Page(write_report(record, folder / "report.html").read_text(encoding="utf-8"))


@pytest.fixture(scope="module")
def page(tuned, tmp_path_factory):
    return page_of(tuned, tmp_path_factory.mktemp("page"))


def table(page, beginning):
    (rows,) = [rows for name, rows in page.tables.items() if name.startswith(beginning)]
    return {row[0]: row[1:] for row in rows}


def test_the_answer_is_that_of_the_journal(page, tuned):
    from report_runs import HARM

    rows = table(page, "Gains and limits")
    for column in (0, 1):
        evaluations = [
            recorded.outcome.metrics
            for recorded in tuned.evaluations
            if recorded.stage is Stage.VALIDATION and recorded.trial == column
        ]
        errors = [metrics["error"] for metrics in evaluations]
        mean = math.fsum(errors) / len(errors)
        assert rows[f"error [{HARM}] mean, objective"][column] == f"{mean:.4g}"
        (peak,) = [row for name, row in rows.items() if name.startswith("peak [N] largest")]
        assert peak[column] == f"{max(m['peak'] for m in evaluations):.4g}"
    best = tuned.trials[tuned.summary["trial"]].parameters["gain"]
    values = table(page, "Set")
    (gain,) = [row for name, row in values.items() if name.startswith("gain")]
    assert gain[:2] == ["0.5", f"{best:.4g}"]


def test_what_to_do_next_names_the_folder_that_the_run_is_in(tuned, tmp_path):
    folder = tmp_path / "axes" / "first"
    folder.mkdir(parents=True)
    record = dataclasses.replace(tuned, path=folder)
    text = write_report(record, folder / "report.html").read_text(encoding="utf-8")
    assert "axes/first" in text
    assert "runs/first" not in text


def test_every_trial_is_listed_with_its_values(page, tuned):
    rows = table(page, f"{len(tuned.trials)} trials")
    for trial in tuned.trials:
        gain, mean, worst, evaluations, outcome, _ = rows[str(trial.number)]
        assert gain == f"{trial.parameters['gain']:.4g}"
        if trial.parameters["gain"] > 0.6:
            assert (mean, worst, outcome) == ("–", "–", "failed")
        else:
            # The models have it from a few draws: the load is 1.5 in the mean.
            true = 1.0 + 1.5 * (trial.parameters["gain"] - 0.3) ** 2
            assert float(mean) == pytest.approx(true, abs=0.01)
            assert int(evaluations) >= len(trial.evaluations)


def test_the_result_and_the_nearest_trials_are_marked(page, tuned):
    rows = table(page, f"{len(tuned.trials)} trials")
    marks = {int(number): row[-1] for number, row in rows.items() if number.isdigit()}
    result = tuned.trials[tuned.summary["trial"]]
    assert [number for number, mark in marks.items() if mark == "result"] == [result.number]
    # One parameter on a linear scale, so the distance is that of the gain itself.
    distance = {
        t.number: abs(t.parameters["gain"] - result.parameters["gain"]) for t in tuned.trials
    }
    near = [distance[number] for number, mark in marks.items() if mark == "neighbour"]
    far = [distance[number] for number, mark in marks.items() if not mark]
    assert len(near) == 3
    assert max(near) <= min(far)


def test_failures_are_listed_with_what_repeats_them(page, tuned):
    (rows,) = [rows for name, rows in page.tables.items() if name.startswith("Failed test runs")]
    failed = [r for r in tuned.evaluations if r.outcome.state is not EvaluationState.COMPLETE]
    assert failed
    assert [row[0] for row in rows[1:]] == [str(evaluation.trial) for evaluation in failed]
    for row, evaluation in zip(rows[1:], failed, strict=True):
        assert row[3] == evaluation.outcome.reason
        assert row[5] == f"load {evaluation.context['load']:.4g}"
        assert row[6] == str(evaluation.seed)


def test_the_page_needs_nothing_else(page):
    for tag, attributes in page.elements:
        for name in ("src", "href", "srcset", "data", "action"):
            if name in attributes:
                # Files of the run may be opened from it, but nothing is loaded.
                allowed = ("#", "data:", "./", "../") if tag == "a" else ("#", "data:")
                assert attributes[name].startswith(allowed), (tag, attributes)
    assert {tag for tag, _ in page.elements}.isdisjoint({"iframe", "object", "embed", "base"})


def test_only_our_scripts_may_run(page):
    policies = [a["content"] for t, a in page.elements if a.get("http-equiv")]
    (policy,) = policies
    allowed = set(re.search("script-src ([^;]*);", policy).group(1).split())
    running = [text for kind, text in page.scripts if kind != "application/json"]
    digests = [hashlib.sha256(text.encode()).digest() for text in running]
    assert {f"'sha256-{base64.b64encode(d).decode()}'" for d in digests} == allowed
    assert len(running) == 5
    assert "default-src 'none'" in policy


def test_texts_of_a_study_stay_texts(page, tuned):
    from report_runs import HARM

    # The study's texts have scripts and images in them; the page has none but its own.
    assert HARM in tuned.study.description
    assert not [attributes for tag, attributes in page.elements if tag == "img"]
    assert not [a for _, a in page.elements if any(name.startswith("on") for name in a)]
    assert any(HARM in cell for rows in page.tables.values() for row in rows for cell in row)


def test_no_text_of_a_study_steers_or_reorders_the_page(tuned):
    """In what a browser shows there is none of these characters, in whichever way they came."""
    hostile, characters = "\x1b[2Jx\x9b\u202etxt\u2066\u200f", set("\x1b\x9b\u202e\u2066\u200f")
    study = tuned.study
    named = {
        what: {name: replace(item, unit=hostile) for name, item in getattr(study, what).items()}
        for what in ("parameters", "metrics")
    }
    run = replace(tuned, study=replace(study, description=hostile, **named))
    analysis = Analysis(run)
    text = render(analysis, chapters(analysis))
    assert not characters & set(unescape(text))
    data = re.findall(r'<script type="application/json"[^>]*>(.*?)</script>', text, re.DOTALL)
    assert len(data) > 1
    assert not characters & {c for each in map(json.loads, data) for c in "".join(texts(each))}
    assert text.count(r"\x1b[2Jx\x9b\u202etxt\u2066\u200f") > 5


def texts(value):
    """All texts in a JSON value."""
    if isinstance(value, dict):
        value = [*value, *value.values()]
    if isinstance(value, list):
        return [text for item in value for text in texts(item)]
    return [value] if isinstance(value, str) else []


def test_the_commands_of_the_report_work_from_any_folder(tuned):
    steps = answer(Analysis(tuned)).steps
    assert steps
    for step in steps:
        assert str(tuned.path.resolve()) in shlex.split(step.command)


def test_what_is_the_result_the_default_or_over_the_limit_looks_the_same_in_all_figures(tuned):
    analysis = Analysis(tuned)
    elements = [
        element
        for figure in report_figures(analysis, chapters(analysis))
        for panel in figure.panels
        for element in panel.elements
    ]
    expected = {"tuned": RESULT, "default": DEFAULT, "over the limit": OVER_LIMIT}
    for name, (color, marker) in expected.items():
        named = [e for e in elements if getattr(e, "name", "") == name]
        assert {e.color for e in named} == {color}, name
        marks = {e.marker for e in named if isinstance(e, Points)}
        assert marks <= {marker}, name
    assert {e.marker for e in elements if isinstance(e, Points) and e.name == "tuned"}


def test_headings_go_down_step_by_step(page):
    levels = [int(tag[1]) for tag, _ in page.elements if re.fullmatch("h[1-6]", tag)]
    assert levels[0] == 1
    assert levels.count(1) == 1
    assert all(b - a <= 1 for a, b in itertools.pairwise(levels))


def test_every_table_has_a_caption_and_every_figure_a_text(page):
    assert len(page.tables) == sum(tag == "table" for tag, _ in page.elements)
    described = [a["aria-label"] for _, a in page.elements if a.get("role") == "img"]
    assert len(described) == sum(tag == "figure" for tag, _ in page.elements) > 5
    assert all(described)


def test_a_run_in_progress_has_a_report(tuned, tmp_path):
    going_on = dataclasses.replace(
        tuned,
        summary=None,
        trials=tuned.trials[:4],
        evaluations=tuple(recorded for recorded in tuned.evaluations if recorded.trial < 4),
    )
    page = page_of(going_on, tmp_path)
    assert "Best so far" in page.tables
    assert "4 trials" in page.tables
    # What is marked is no result yet.
    drawn = {attributes.get("data-name") for _, attributes in page.elements}
    assert ("best so far" in drawn, "tuned" in drawn) == (True, False)


def test_a_run_without_any_trial_has_a_report(tuned, tmp_path):
    page = page_of(dataclasses.replace(tuned, summary=None, trials=(), evaluations=()), tmp_path)
    assert "0 trials" in page.tables


def test_a_run_in_which_everything_failed_has_a_report(axis_run, tmp_path):
    from report_runs import with_ends

    run = axis_run(**with_ends(-1.0))
    page = page_of(run, tmp_path)
    text = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert "found: 7 of 7 trials failed: axis: " in text
    assert len(page.tables["Failed test runs, in the order in which they ran"]) == 1 + 7


def test_a_run_without_a_feasible_point_says_so(axis_run, tmp_path):
    limit = {"peak": {"kind": "worst_case", "metric": "peak", "upper": -1.0}}
    page_of(axis_run(constraints=limit), tmp_path)
    text = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert "not within limits: do not use it" in text


def test_a_study_without_contexts_and_limits_has_a_report(axis_run, tmp_path):
    page = page_of(axis_run(contexts={}, constraints={}), tmp_path)
    assert not any(name.startswith("peak [N] largest") for name in table(page, "Gains and limits"))
    ids = [attributes.get("id") for _, attributes in page.elements]
    assert "contexts" not in ids
    assert "figure-slices" in ids


@pytest.mark.parametrize(
    "changes",
    [
        {"objective": {"metric": "error", "direction": "maximize", "scale": "log"}},
        {
            "constraints": {
                "often": {"kind": "chance", "metric": "peak", "upper": 1.0, "probability": 0.8}
            }
        },
        {
            "contexts": {
                name: {"node": "axis", "distribution": "uniform", "bounds": [1.0, 2.0]}
                for name in ("load", "mass", "stiffness")
            }
        },
    ],
    ids=["maximized", "chance", "three contexts"],
)
def test_other_studies_have_a_report(axis_run, tmp_path, changes):
    page = page_of(axis_run(**changes), tmp_path)
    assert any(a.get("id") == "figure-slices" for _, a in page.elements)


def test_damage_is_told(tuned, tmp_path):
    write_report(
        dataclasses.replace(tuned, damage="evaluation 7 is <damaged>"), tmp_path / "a.html"
    )
    text = (tmp_path / "a.html").read_text(encoding="utf-8")
    assert "The record is damaged: evaluation 7 is &lt;damaged&gt;" in text


def test_a_report_replaces_the_one_before(tuned, tmp_path):
    path = tmp_path / "new" / "report.html"
    assert write_report(tuned, path) == path
    first = path.read_bytes()
    path.write_text("old")
    write_report(tuned, path)
    assert path.read_bytes() == first
    assert list(path.parent.iterdir()) == [path]


def test_a_file_that_cannot_be_written_is_an_output_error(tuned, tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError, match=r"report.html: cannot be written"):
        write_report(tuned, tmp_path / "file" / "report.html")


@pytest.mark.parametrize(
    "summary", [{"trial": 99}, {"trial": 1}, {"trial": 1, "default": {}, "tuned": None}]
)
def test_a_summary_of_another_program_is_refused(tuned, tmp_path, summary):
    with pytest.raises(RunRecordError, match="summary"):
        write_report(dataclasses.replace(tuned, summary=summary), tmp_path / "report.html")


def test_the_run_folder_stays_as_it_was(tuned, tmp_path):
    def content():
        # SQLite's index of its log notes who reads.
        files = [p for p in tuned.path.iterdir() if p.is_file() and not p.name.endswith("-shm")]
        return {path.name: path.read_bytes() for path in files}

    before = content()
    write_report(read_run(tuned.path), tmp_path / "report.html")
    assert content() == before


def test_one_of_each_is_no_plural(axis_run):
    """On the page of the smallest run, and where its only trial failed."""
    for sections in ({}, with_ends(0.4)):
        of_one = Analysis(axis_run(budget=ONE_OF_EACH, **sections))
        text = unescape(render(of_one, chapters(of_one)))
        shown = re.sub(r"<(script|style|pre)\b.*?</\1>", "", text, flags=re.DOTALL)
        assert re.findall(r"\b1 (?:trials|(?:test )?runs|draws|parameter sets)\b", shown) == []
