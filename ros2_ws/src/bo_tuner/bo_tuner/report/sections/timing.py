"""Where the time went: evaluations against the optimizer."""

import numpy as np

from bo_tuner.figures.figure import Axis, Bars, Color, Figure, Panel
from bo_tuner.report.analysis import CHECKS, Analysis
from bo_tuner.report.content import Section, quantity
from bo_tuner.trials import Stage


def timing(analysis: Analysis) -> Section | None:
    """Show the seconds of evaluations and of proposals; None before the first trial."""
    trials = analysis.record.trials
    if not trials:
        return None
    cutting = np.array(
        [sum(evaluation.seconds for evaluation in trial.evaluations) for trial in trials]
    )
    proposing = np.array([trial.seconds for trial in trials])
    total = float(cutting.sum() + proposing.sum())
    title = "Where the time went"
    if total <= 0.0:
        return Section(name="time", title=title, lead="The record holds no times.")
    share = 100.0 * float(proposing.sum()) / total
    after = {
        "checks of candidates": sum(
            r.seconds for r in analysis.record.evaluations if r.stage in CHECKS
        ),
        "validation": sum(
            r.seconds for r in analysis.record.evaluations if r.stage is Stage.VALIDATION
        ),
    }
    said = "".join(f", {name} {quantity(s, 's')}" for name, s in after.items() if s > 0.0)
    lead = (
        f"Evaluations of the trials took {quantity(float(cutting.sum()), 's')}, proposals "
        f"{quantity(float(proposing.sum()), 's')} ({share:.0f} % of both){said}."
    )
    places = np.array([trial.number for trial in trials], dtype=float)
    figure = Figure(
        name="time",
        title="Time of each trial",
        caption="The proposal is what the optimizer needs: fits of the surrogates and the search "
        "of the acquisition's maximum. The search of the worst context between the runs is in "
        "neither.",
        alternative=lead,
        panels=[
            Panel(
                x=Axis(label="trial"),
                y=Axis(label="time", unit="s"),
                elements=[
                    Bars(
                        x=places, y=cutting, base=np.zeros(len(places)), name="cuts",
                        color=Color.SKY,
                    ),
                    Bars(
                        x=places, y=proposing, base=cutting, name="proposal", color=Color.PURPLE
                    ),
                ],
            )
        ],
        panel_height=280,
    )  # fmt: skip
    return Section(name="time", title=title, lead=lead, figures=[figure])
