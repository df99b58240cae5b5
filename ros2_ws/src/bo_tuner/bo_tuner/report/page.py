"""The report as one self-contained HTML file, which needs no network and no other file."""

import base64
import hashlib
import importlib.resources
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any
from urllib.parse import quote

from jinja2 import Environment, PackageLoader, StrictUndefined

from bo_tuner.evidence.verdict import State
from bo_tuner.figures.figure import Figure
from bo_tuner.figures.keys import color_bars, legend
from bo_tuner.figures.palette import DARK, LIGHT
from bo_tuner.figures.svg_renderer import hover_texts, panels_svg, symbols
from bo_tuner.monitoring.progress import why
from bo_tuner.report.analysis import Analysis, Known
from bo_tuner.report.content import Chapter, Section, WhatIf, number
from bo_tuner.report.live import (
    bar,
    best_values,
    latest_trials,
    limit_panels,
    objective_panel,
    step_in_words,
)
from bo_tuner.report.sections.answer import answer
from bo_tuner.report.sections.appendix import all_trials, provenance
from bo_tuner.report.sections.contexts import contexts
from bo_tuner.report.sections.convergence import convergence
from bo_tuner.report.sections.draws import draws
from bo_tuner.report.sections.effects import effects
from bo_tuner.report.sections.failures import failures
from bo_tuner.report.sections.front import front
from bo_tuner.report.sections.parallel import parallel
from bo_tuner.report.sections.surrogates import surrogates
from bo_tuner.report.sections.timing import timing
from bo_tuner.report.sections.tolerance import tolerance
from bo_tuner.report.sections.trade_off import trade_off
from bo_tuner.report.sections.trajectories import trajectories
from bo_tuner.storage.atomic import write_atomically, writing
from bo_tuner.storage.record import RunRecord
from bo_tuner.study.study import Study
from bo_tuner.text import capitalized, printable
from bo_tuner.trials import Trial
from bo_tuner.tuning.question import Asked

OF_LISTS = ("tables.js",)
"""Scripts of a page without figures."""
OF_REPORTS = ("figures.js", "copy.js", *OF_LISTS, "trials.js", "what_if.js")
"""Scripts of a page with figures."""

FORMATS = ("png", "svg")
"""Kinds of image files of a figure."""


def certificate(analysis: Analysis) -> Section | None:
    """Show the certificate; None without one."""
    if problem := analysis.certificate_problem:
        return Section(name="certificate", title="Certificate: not readable", lead=f"{problem}.")
    return analysis.certificate_section


Maker = Callable[[Analysis], Section | None]


@dataclass(frozen=True)
class Outline:
    """What makes the sections of a chapter, in order; each returns None if it does not apply."""

    name: str
    title: str
    makers: tuple[Maker, ...]
    closed: bool = False


OUTLINES = (
    Outline("evidence", "Evidence", (certificate, draws, contexts, tolerance)),
    Outline("signals", "Signals", (trajectories,)),
    Outline("parameters", "Parameters", (effects, surrogates, parallel)),
    Outline("trials", "Trials", (convergence, front, trade_off, all_trials)),
    Outline("details", "Details", (failures, timing, provenance), closed=True),
)
"""The chapters of a report behind the result, in order."""


def chapters(analysis: Analysis) -> list[Chapter]:
    """Return the chapters of a run's report in order, without what does not apply."""
    made = (chapter(analysis, outline) for outline in OUTLINES)
    return [item for item in made if item is not None]


def chapter(analysis: Analysis, outline: Outline) -> Chapter | None:
    """Return a chapter of a run's report; None if none of its sections applies."""
    made = (make(analysis) for make in outline.makers)
    sections = [section for section in made if section is not None]
    if not sections:
        return None
    return Chapter(name=outline.name, title=outline.title, sections=sections, closed=outline.closed)


def figures(parts: Sequence[Section]) -> list[Figure]:
    """Return the figures of sections."""
    return [figure for section in parts for figure in section.figures]


def report_figures(analysis: Analysis, parts: Sequence[Chapter]) -> list[Figure]:
    """Return the figures of a run's report: those of the result and of chapters."""
    of_result = answer(analysis).figure
    others = figures([section for part in parts for section in part.sections])
    return others if of_result is None else [of_result, *others]


def write_report(run: RunRecord, path: Path, known: Known | None = None) -> Path:
    """Write the report of a run to `path` and return it."""
    analysis = Analysis(run, known or Known())
    return write_page(analysis, chapters(analysis), path)


def write_page(analysis: Analysis, parts: Sequence[Chapter], path: Path) -> Path:
    """Write the page with these chapters to `path` and return it; raises as `write_atomically`."""
    return _write(path, render(analysis, parts, os.path.relpath(analysis.record.path, path.parent)))


def trial_html(
    analysis: Analysis,
    trial: Trial,
    parts: Sequence[Section],
    template: str = "trial.html",
    **more: Any,
) -> str:
    """Return the HTML of the page of a trial; a `template` that extends it may need more."""
    return fill(
        template,
        study=analysis.study,
        number=trial.number,
        sections=parts,
        **more,
    )


def write_trial(analysis: Analysis, trial: Trial, parts: Sequence[Section], path: Path) -> Path:
    """Write the page of a trial to `path` and return it; raises as `write_atomically`."""
    return _write(path, trial_html(analysis, trial, parts))


def write_comparison(title: str, parts: Sequence[Section], path: Path) -> Path:
    """Write the page that compares runs to `path` and return it; raises as `write_atomically`."""
    return _write(
        path, fill("comparison.html", sections=parts, title=title, home="", of="tuning runs")
    )


def write_single_run(title: str, parts: Sequence[Section], path: Path) -> Path:
    """Write the page of a single run to `path` and return it; raises as `write_atomically`."""
    return _write(path, fill("single_run.html", sections=parts, title=title))


def write_figure(figure: Figure, folder: Path, formats: Sequence[str] = FORMATS) -> list[Path]:
    """Write ``<folder>/<name>.<format>`` for each of the formats and return the paths.

    It raises as `write_atomically`.
    """
    # Matplotlib takes a second to load.
    from bo_tuner.figures.matplotlib_renderer import render

    return [_write(folder / f"{figure.name}.{kind}", render(figure, kind)) for kind in formats]


def _write(path: Path, content: str | bytes) -> Path:
    with writing(path):
        path.parent.mkdir(parents=True, exist_ok=True)
    # A browser may reload the page while it is written again.
    return write_atomically(path, content)


def question_html(asked: Asked) -> str:
    """Return the HTML of what is asked before a parameter set is tried."""
    return (
        _environment()
        .get_template("question.html")
        .render(
            asked=asked,
            reason=capitalized(f"{why(asked.origin)}."),
            changes=[(change, step_in_words(change)) for change in asked.changes],
            rows=[bar(expected) for expected in asked.expected],
        )
    )


def live_parts(
    study: Study, trials: Sequence[Trial], best: Mapping[int, int | None]
) -> dict[str, str]:
    """Return the HTML of what the page of a run in progress has of its trials, by name.

    `best` is as in `objective_panel`.
    """
    macros: Any = _environment().get_template("live_parts.html").module
    panels = limit_panels(study, trials)
    objective = Figure(
        name="objective",
        title="",
        caption="",
        alternative="The objective by trial; the latest ones stand in the table.",
        panels=[objective_panel(study, trials, best)],
        panel_height=215,
    )
    limits = replace(
        objective,
        name="limits",
        alternative="Each limit by trial; the latest ones stand in the table.",
        panels=panels,
        panel_height=max(80, 172 // max(len(panels), 1)),
    )
    number = best[max(best)] if best else None
    found: dict[str, Any] = {
        "objective": macros.show_objective(objective),
        "limits": macros.show_limits(limits) if panels else "The study has no limits.",
        "trials": macros.show_trials(latest_trials(study, trials)),
        "values": "" if number is None else macros.show_values(best_values(study, trials[number])),
    }
    return {name: str(html) for name, html in found.items()}


def answer_html(analysis: Analysis) -> str:
    """Return the HTML of the answer by itself, without links to files.

    Without a result there are no steps either: the run is going on.
    """
    content = replace(answer(analysis), files=())
    if analysis.verdict.state is State.OPEN:
        content = replace(content, steps=())
    macros = _macros()
    bar = f"{macros.show_mark(content)}{macros.show_actions(content, '')}"
    return f'<div class="bar result">{bar}</div>{macros.show_answer(content)}'


def list_html(**content: object) -> str:
    """Return the HTML of the list of runs by itself, with the content of its page."""
    return _environment().get_template("runs_list.html").render(**content)


def render(
    analysis: Analysis,
    parts: Sequence[Chapter],
    run: str | None = os.curdir,
    template: str = "report.html",
    scripts: Sequence[str] = (),
    **more: Any,
) -> str:
    """Return the HTML of the page, with links into the run folder by its relative path, if any.

    A `template` that extends that of the report may need further `scripts` and content.
    """
    content = answer(analysis)
    return fill(
        template,
        [*OF_REPORTS, *scripts],
        sections=[],
        chapters=parts,
        study=analysis.study,
        record=analysis.record,
        answer=replace(content, files=()) if run is None else content,
        base=quote(os.fsencode(f"{run}/")),
        **more,
    )


def fill(template: str, scripts: Sequence[str] = OF_REPORTS, **content: object) -> str:
    """Fill a template that extends the base of all pages."""
    texts = [_template(name) for name in scripts]
    allowed = [f"'sha256-{_digest(text)}'" for text in texts]
    return (
        _environment()
        .get_template(template)
        .render(
            **content,
            style=_template("report.css"),
            light=LIGHT,
            dark=DARK,
            scripts=texts,
            symbols=symbols(),
            policy=" ".join(allowed),
        )
    )


@cache
def _environment() -> Environment:
    environment = Environment(
        loader=PackageLoader("bo_tuner.report"),
        autoescape=True,
        undefined=StrictUndefined,
        finalize=_shown,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["legend"] = legend
    environment.filters["color_bars"] = color_bars
    environment.filters["hover_texts"] = hover_texts
    environment.filters["pictures"] = panels_svg
    environment.filters["value"] = number
    environment.filters["what_if_data"] = _forecasts
    return environment


def _forecasts(what_if: WhatIf) -> dict[str, object]:
    """Return what the sliders need; titles, which are texts of others, stand in the page alone."""
    sliders = [
        {"name": each.name, "values": each.values, "words": each.words, "place": each.place}
        for each in what_if.sliders
    ]
    along = [[asdict(f) for f in each] for each in what_if.along]
    return {"sliders": sliders, "along": along, "command": what_if.command}


def _shown(value: Any) -> Any:
    """Make text of others fit for a page; markup is that of the templates."""
    is_text = isinstance(value, str) and not hasattr(value, "__html__")
    return printable(value) if is_text else value


def _macros() -> Any:
    return _environment().get_template("macros.html").module


def _template(name: str) -> str:
    path = importlib.resources.files("bo_tuner.report") / "templates" / name
    return path.read_text(encoding="utf-8").strip()


def _digest(script: str) -> str:
    return base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
