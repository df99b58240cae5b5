"""What the surrogates believe of the parameters."""

from bo_tuner.report.analysis import Analysis
from bo_tuner.report.content import Section
from bo_tuner.report.sections.contours import MOST_PARAMETERS, contours, most_sensitive
from bo_tuner.report.sections.slices import slices


def landscape(analysis: Analysis) -> Section | None:
    """Show the surrogates around the answer; None while no trial is complete."""
    answer = analysis.answer
    if answer is None or analysis.models.objective is None:
        return None
    names = analysis.study.search_space().names
    figures = [slices(analysis, answer)]
    notes = [
        "A trial is drawn into a slice if its other parameters are within a tenth of their ranges."
    ]
    if len(names) > 1:
        figures.append(contours(analysis, answer))
    if len(names) > MOST_PARAMETERS:
        chosen = ", ".join(most_sensitive(analysis))
        notes.append(f"Pairs are drawn of the parameters that matter most: {chosen}.")
    notes += [f"Fit: {warning}." for warning in analysis.models.warnings]
    return Section(
        name="surrogates",
        title="What the surrogates believe",
        lead=f"Gaussian processes fitted to all trials, in slices through trial {answer.number}: "
        "how the answer reacts to each parameter, and how much room is left to the limits.",
        figures=figures,
        notes=notes,
    )
