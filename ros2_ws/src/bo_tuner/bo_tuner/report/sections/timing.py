"""Computation time: evaluations and proposals."""

import numpy as np

from bo_tuner.figures.figure import Axis, Bars, Color, Figure, Panel
from bo_tuner.report.analysis import Analysis
from bo_tuner.report.content import Section, quantity
from bo_tuner.text import counted
from bo_tuner.trials import CHECKS, Stage


def timing(analysis: Analysis) -> Section | None:
    """Show the seconds of evaluations and of proposals; None before the first trial."""
    trials = analysis.record.trials
    if not trials:
        return None
    evaluating = np.array(
        [sum(evaluation.seconds for evaluation in trial.evaluations) for trial in trials]
    )
    proposing = np.array([trial.seconds for trial in trials])
    total = float(evaluating.sum() + proposing.sum())
    title = "Where does the time go?"
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
    later = "".join(f", {name} {quantity(s, 's')}" for name, s in after.items() if s > 0.0)
    lead = (
        f"Test runs of the trials took {quantity(float(evaluating.sum()), 's')}, proposals "
        f"{quantity(float(proposing.sum()), 's')} ({share:.0f} % of both){later}."
    )
    notes = [evaluation.outcome.notes for evaluation in analysis.record.evaluations]
    if count := sum(noted.starts for noted in notes):
        seconds = sum(noted.start_seconds for noted in notes)
        lead += (
            f" Of the test runs {quantity(seconds, 's')} went into {counted(count, 'start')} of "
            f"nodes with other values, {quantity(seconds / count, 's')} each."
        )
    if rested := sum(noted.rested_seconds for noted in notes):
        lead += f" For {quantity(rested, 's')} of the test runs the machine was at rest."
    if ramped := sum(noted.ramped_seconds for noted in notes):
        lead += f" For {quantity(ramped, 's')} the parameters were on their way to others."
    if count := sum(noted.warm_ups for noted in notes):
        warming = sum(noted.warm_up_seconds for noted in notes)
        lead += f" Beside these, {counted(count, 'run')} to warm up took {quantity(warming, 's')}."
    places = np.array([trial.number for trial in trials], dtype=float)
    figure = Figure(
        name="time",
        title="Time of each trial",
        caption="A proposal includes fitting the models and maximizing the acquisition function. "
        "The search for the worst context between test runs is in neither.",
        alternative=lead,
        panels=[
            Panel(
                x=Axis(label="trial"),
                y=Axis(label="time", unit="s"),
                elements=[
                    Bars(
                        x=places, y=evaluating, base=np.zeros(len(places)), name="test runs",
                        color=Color.SKY,
                    ),
                    Bars(
                        x=places, y=proposing, base=evaluating, name="proposal", color=Color.PURPLE
                    ),
                ],
            )
        ],
        panel_height=280,
    )  # fmt: skip
    return Section(name="time", title=title, lead=lead, figures=[figure])
