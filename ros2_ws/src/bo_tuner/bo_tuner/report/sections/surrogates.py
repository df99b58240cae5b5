"""The surrogates around the answer, as slices and contours."""

from bo_tuner.report.analysis import Analysis
from bo_tuner.report.content import Section
from bo_tuner.report.sections.contours import MOST_PARAMETERS, contours, most_sensitive
from bo_tuner.report.sections.slices import slices
from bo_tuner.report.sections.what_if import what_if


def surrogates(analysis: Analysis) -> Section | None:
    """Show the surrogates around the answer; None before a trial is complete."""
    answer = analysis.answer
    if answer is None or analysis.models.objective is None:
        return None
    space = analysis.study.search_space()
    names = space.numbers
    if not names:
        return None
    titles = {name: item.title for name, item in analysis.study.parameters.items()}
    figures = [slices(analysis, answer)]
    notes = []
    if len(names) > 1:
        figures.append(contours(analysis, answer))
    if len(names) > MOST_PARAMETERS:
        chosen = ", ".join(titles[name] for name in most_sensitive(analysis))
        notes.append(f"Pairs of the parameters with the shortest length scales: {chosen}.")
    if len(names) < space.dimension:
        others = ", ".join(titles[name] for name in space.names if name not in names)
        notes.append(f"Without an axis of numbers: {others}; as in the {analysis.answer_set}.")
    notes += [f"Fit: {warning}." for warning in analysis.models.warnings]
    return Section(
        name="surrogates",
        title="What do the models say?",
        lead=f"Models (Gaussian processes) of all trials, around trial {answer.number}.",
        figures=figures,
        notes=notes,
        what_if=what_if(analysis),
    )
