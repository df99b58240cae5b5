"""Parallel coordinates (Inselberg 1985): all trials of a study with many parameters at once."""

import numpy as np

from bo_tuner.evidence.trial_row import TrialOutcome
from bo_tuner.figures.figure import Axis, Color, Dash, Element, Figure, Line, Panel
from bo_tuner.report.analysis import Analysis
from bo_tuner.report.content import Section
from bo_tuner.report.marks import OVER_LIMIT, RESULT
from bo_tuner.text import shown
from bo_tuner.trials import Trial

FEWEST = 4
"""Number of tuned parameters from which on two at a time no longer show a run."""

STYLES = {
    TrialOutcome.VIOLATES: (OVER_LIMIT[0], Dash.DOTTED, 1.0),
    TrialOutcome.UNCERTAIN: (Color.SKY, Dash.DOTTED, 1.2),
    TrialOutcome.WITHIN: (Color.GREEN, Dash.DASHED, 1.5),
}
"""Colour, dash and width by the outcome of a trial; the others say little of the parameters."""


def parallel(analysis: Analysis) -> Section | None:
    """Show each trial as a line over the tuned parameters; None for few parameters."""
    space = analysis.study.search_space()
    if space.dimension < FEWEST or not analysis.trials:
        return None
    elements: list[Element] = []
    for kind, (color, dash, width) in STYLES.items():
        chosen = [trial for trial in analysis.trials if analysis.outcome(trial) == kind]
        if chosen:
            elements.append(_lines(analysis, chosen, kind, color, dash, width))
    if analysis.answer is not None:
        elements.append(
            _lines(analysis, [analysis.answer], analysis.answer_name, RESULT[0], Dash.SOLID, 3.0)
        )
    ticks = [(float(k), _ends(analysis, name)) for k, name in enumerate(space.names)]
    return Section(
        name="parallel",
        title="All parameters at once",
        lead=f"{space.dimension} tuned parameters; each line is a trial.",
        figures=[
            Figure(
                name="parallel",
                title="Which values have the trials within limits?",
                caption="Where the lines within the limits come together, a parameter matters; "
                "where they spread, it does not, or others make up for it. Failed and far-off "
                "trials are left out. Below each name are its lower and upper bound.",
                alternative="Parallel coordinates of all trials.",
                panels=[
                    Panel(
                        x=Axis(label="", ticks=ticks),
                        y=Axis(label="place between the bounds", limits=(-0.02, 1.02)),
                        elements=elements,
                    )
                ],
            )
        ],
    )


def _ends(analysis: Analysis, name: str) -> str:
    """Return the name of a parameter with the ends of its axis."""
    item = analysis.study.parameters[name]
    ends = item.levels or item.bounds
    return item.title if not ends else f"{item.title}\n{shown(ends[0])} … {shown(ends[-1])}"


def _lines(
    analysis: Analysis, trials: list[Trial], name: str, color: Color, dash: Dash, width: float
) -> Line:
    """Return the lines of trials as one, with gaps."""
    space = analysis.study.search_space()
    # NaN ends the line of a trial.
    x = np.tile([*range(space.dimension), np.nan], len(trials))
    y = np.concatenate([[*space.to_cube(trial.parameters), np.nan] for trial in trials])
    texts = [
        f"{name}: trial {trial.number}\n{analysis.tuned_in_words(trial.parameters)}"
        for trial in trials
    ]
    points = space.dimension + 1
    return Line(
        x=x,
        y=y,
        name=name,
        color=color,
        dash=dash,
        width=width,
        hover=[text for text in texts for _ in range(points)],
        trials=[trial.number for trial in trials for _ in range(points)],
    )
