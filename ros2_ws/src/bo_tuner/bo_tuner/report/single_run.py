"""The page of a single run: its parameters, its metrics beside the limits, and its response."""

from collections.abc import Sequence
from dataclasses import replace
from itertools import cycle

from bo_tuner.evidence.single_run import BEYOND, SingleRun
from bo_tuner.figures.figure import Color, Dash, Element, Figure, Line, Panel
from bo_tuner.metrics.recording import Recording
from bo_tuner.recording.signal_bag import RecordedRun
from bo_tuner.report.content import Section, Table, number
from bo_tuner.report.recorded_signals import signal_panels
from bo_tuner.report.sections.trajectories import STYLES, Trace, panels
from bo_tuner.study.offers import REFERENCE
from bo_tuner.study.study import Study
from bo_tuner.text import values
from bo_tuner.trials import DEFAULT, TUNED

THIS = "this run"
COLORS = (STYLES[TUNED][0], STYLES[DEFAULT][0], Color.GREEN, Color.PURPLE)
"""Of the signals in a panel."""


def recorded_response(study: Study, recording: Recording) -> list[Panel]:
    """Return the signals of a run as they were received; none if there are none."""
    if not recording.signals:
        return []
    run = RecordedRun("", 0, {}, recording)
    return _told_apart(signal_panels(study, {THIS: run}, {THIS: STYLES[TUNED]}))


def traced_response(study: Study, trace: Trace) -> list[Panel]:
    """Return the signals of a run that its objects have traced."""
    return _told_apart(panels({"": {THIS: trace}}, {THIS: STYLES[TUNED]}, study))


def _told_apart(drawn: Sequence[Panel]) -> list[Panel]:
    """Give several signals in one panel, which are all of this run, a colour each.

    What the others are to follow is drawn as in all figures; a single run shows it by its name.
    """
    told_apart = []
    for panel in drawn:
        colors = cycle(COLORS)
        count = sum(_is_own(element) for element in panel.elements)
        elements: list[Element] = []
        for element in panel.elements:
            if not isinstance(element, Line) or not _is_own(element):
                elements.append(element)
            elif count > 1 and REFERENCE.search(element.name):
                elements.append(replace(element, color=Color.INK, dash=Dash.DOTTED))
            else:
                elements.append(replace(element, color=next(colors)))
        told_apart.append(replace(panel, elements=elements))
    return told_apart


def _is_own(element: Element) -> bool:
    return isinstance(element, Line) and (element.color, element.dash) == STYLES[TUNED]


def response_figure(run: SingleRun, drawn: Sequence[Panel], caption: str) -> Figure:
    """Return the figure of the response."""
    return Figure(
        name="response",
        title=f"{run.study.name}: {run.headline}",
        caption=caption,
        alternative=f"Signals over time: {', '.join(panel.y.label for panel in drawn)}.",
        panels=drawn,
        panel_height=260,
    )


def single_run_sections(run: SingleRun, figure: Figure | None, missing: str) -> list[Section]:
    """Return the sections of the page."""
    study, evaluation = run.study, run.evaluation
    defaults, rows = study.on_screen(study.search_space().defaults), list(run.rows())
    given = study.on_screen(evaluation.parameters)
    parameters = Table(
        caption="Parameters",
        header=["parameter", "default", THIS, "unit"],
        rows=[
            [
                item.title_and_name,
                number(defaults[name]),
                number(given[name]),
                item.unit,
            ]
            for name, item in study.parameters.items()
        ],
        numeric=[1, 2],
    )
    metrics = Table(
        caption="Metrics",
        header=["metric", "value", "unit", "limit", ""],
        rows=[[row.metric, row.value, row.unit, row.limit, row.standing] for row in rows],
        numeric=[1],
        marked=[place for place, row in enumerate(rows) if row.standing == BEYOND],
    )
    context = values(evaluation.context)
    return [
        Section(
            name="run",
            title=f"{run.headline[:1].upper()}{run.headline[1:]}",
            lead=f"One run{f' at {context}' if context else ''}, with the noise of seed "
            f"{evaluation.seed}. A single run proves nothing: validate certifies.",
            tables=[metrics, parameters],
        ),
        Section(
            name="response",
            title="Response",
            lead=missing,
            figures=[] if figure is None else [figure],
        ),
    ]
