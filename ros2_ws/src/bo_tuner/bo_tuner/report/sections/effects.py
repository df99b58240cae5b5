"""What each tuned parameter does: steps away from the result, shares of variance, effects seen."""

from collections.abc import Mapping
from math import isinf

import numpy as np

from bo_tuner.evidence.certificate.parameter_sensitivity import (
    Neighbour,
    ParameterSensitivity,
    parameter_sensitivity,
)
from bo_tuner.evidence.trial_row import OF_VALUE
from bo_tuner.evidence.words.certificate import of_narrow, of_step
from bo_tuner.evidence.words.effects import amount, title_of
from bo_tuner.evidence.words.verdict import of_parameters
from bo_tuner.figures.figure import Axis, Bars, Color, Figure, Panel
from bo_tuner.models.categories import Coding, coded_fit
from bo_tuner.models.gaussian_process import GaussianProcess
from bo_tuner.models.narrowness import TOLERABLE
from bo_tuner.numerics.arrays import Array
from bo_tuner.numerics.seeds import Stream, generator
from bo_tuner.numerics.sobol_indices import total_indices
from bo_tuner.report.analysis import Analysis
from bo_tuner.report.content import Section, Table, number
from bo_tuner.study.metrics import Metric
from bo_tuner.study.study import Study
from bo_tuner.study.titles import mean_title
from bo_tuner.text import capitalized, listed, percent, shown
from bo_tuner.trials import Trial, Value, pooled
from bo_tuner.tuning.effects import Effect, ParameterEffects

FEWEST_FOR_EACH = 5
"""Trials for each parameter, below which a model over all of them says nothing."""
MOST_TRIALS = 200
"""Trials that the models are fitted to, evenly chosen: a fit takes time with their cube."""


def effects(analysis: Analysis) -> Section | None:
    """Show what each parameter does, a row each; None while there is no answer."""
    if analysis.answer is None:
        return None
    study, answer = analysis.study, analysis.answer
    steps = parameter_sensitivity(study, answer.parameters, analysis.models)
    shares = {} if analysis.quick else _shares(analysis)
    by_parameter = {item.parameter: item for item in analysis.verdict.parameter_effects}
    if steps is None and not shares and not by_parameter:
        return None
    names = study.search_space().names
    header = ["parameter", analysis.answer_name]
    if steps is not None:
        header += ["one step down", "one step up"]
    if by_parameter:
        header.append("seen to move")
    rows = []
    for name in names:
        row = [study.parameters[name].title, number(answer.parameters[name])]
        if steps is not None:
            row += _steps(analysis, steps, name)
        if by_parameter:
            row.append(_moved(study, by_parameter.get(name)))
        rows.append(row)
    return Section(
        name="effects",
        title="What does each parameter do?",
        lead=" ".join(
            [*_lead(study, steps), *_unseen(analysis, shares), *of_parameters(analysis.verdict)]
        ),
        figures=[_importance(study, shares)] if shares else [],
        tables=[
            Table(
                caption=f"The tuned parameters, around the {analysis.answer_set}",
                header=header,
                rows=rows,
                numeric=[1],
            )
        ],
    )


def _lead(study: Study, steps: ParameterSensitivity | None) -> list[str]:
    """Say whether a step away from the answer is tolerable."""
    if steps is None or not steps.neighbours:
        return []
    if steps.narrow:
        return [f"{capitalized(of_narrow(study, steps))}."]
    return [
        f"None of {len(steps.neighbours)} steps to a neighbour loses more than "
        f"{100.0 * TOLERABLE:.0f} % of the objective or breaks a limit."
    ]


def _unseen(analysis: Analysis, shares: Mapping[str, Array]) -> list[str]:
    """Name the responses that no parameter was seen to move: of these a model explains noise."""
    study, parameters = analysis.study, analysis.verdict.parameter_effects
    moved = {e.metric for item in parameters for e in item.effects if e.seen}
    still = [
        title
        for name, metric in study.metrics.items()
        if parameters and name not in moved and (title := _mean(metric)) in shares
    ]
    return [f"No effect was seen on {listed(still)}."] if still else []


def _steps(analysis: Analysis, steps: ParameterSensitivity, name: str) -> list[str]:
    """Return what is predicted one step down and one up in a parameter."""
    down: list[str] = []
    up: list[str] = []
    for neighbour in steps.neighbours:
        if name in neighbour.changed:
            old, new = steps.optimum.parameters[name], neighbour.changed[name]
            falls = not isinstance(new, str) and not isinstance(old, str) and new < old
            (down if falls else up).append(_predicted(analysis, steps.optimum, neighbour))
    return ["; ".join(down) or "–", "; ".join(up) or "–"]


def _predicted(analysis: Analysis, optimum: Neighbour, neighbour: Neighbour) -> str:
    """Return the step, the change of the objective, and how likely the limits are kept."""
    parameters = analysis.study.parameters
    step = ", ".join(
        _change(
            "" if len(neighbour.changed) == 1 else f"{parameters[name].title} ",
            optimum.parameters[name],
            value,
        )
        for name, value in neighbour.changed.items()
    )
    text = f"{step}: {of_step(analysis.study, optimum, neighbour)}"
    if analysis.study.constraints:
        text += f", {percent(neighbour.feasibility)} likely within limits"
    return text


def _change(of: str, old: Value, new: Value) -> str:
    if isinstance(old, (bool, str)) or isinstance(new, (bool, str)):
        return f"{of}{shown(new)}"
    difference = new - old
    return f"{of}{difference:+d}" if isinstance(difference, int) else f"{of}{difference:+.3g}"


def _moved(study: Study, parameter: ParameterEffects | None) -> str:
    """Return the metrics that a parameter was seen to move, with the largest differences."""
    if parameter is None:
        return "–"
    seen = [
        f"{title_of(study, e)} ({amount(abs(e.change), e)})" for e in parameter.effects if e.seen
    ]
    if seen:
        return ", ".join(seen)
    visible = [_visible(study, e) for e in parameter.effects if not isinf(e.visible)]
    return f"nothing; visible would have been {', '.join(visible)}" if visible else "nothing"


def _visible(study: Study, effect: Effect) -> str:
    size = f"{amount(effect.visible, effect)} of " if effect.visible else "any of "
    return f"{size}{title_of(study, effect)}"


def _shares(analysis: Analysis) -> dict[str, Array]:
    """Return the total Sobol' index (d,) of each parameter, by response.

    Empty for one parameter or few trials; responses that do not vary are left out.
    """
    space = analysis.study.search_space()
    chosen = [
        trial
        # A repetition in the worst context alone has no mean of its own.
        for trial in pooled(analysis.trials)
        if analysis.outcome(trial) in OF_VALUE
    ]
    if space.dimension < 2 or len(chosen) < FEWEST_FOR_EACH * space.dimension:
        return {}
    chosen = chosen[:: -(-len(chosen) // MOST_TRIALS)]
    return {
        name: _indices(analysis, chosen, y)
        for name, y in _responses(analysis, chosen)
        if np.ptp(y) > 0.0
    }


def _mean(metric: Metric) -> str:
    return mean_title(metric.title)


def _responses(analysis: Analysis, trials: list[Trial]) -> list[tuple[str, Array]]:
    """Return each response by its name, with its value (N,) in each of the trials."""
    study = analysis.study
    means = [
        (_mean(metric), np.array([np.mean(trial.observations(name)) for trial in trials]))
        for name, metric in study.metrics.items()
    ]
    worst = [
        (
            f"{item.extreme} {study.metrics[item.metric].title} in the worst context",
            np.array([trial.worst_cases[item.name].value for trial in trials]),
        )
        for item in study.worst_case_constraints
        if all(item.name in trial.worst_cases for trial in trials)
    ]
    return worst + means


def _indices(analysis: Analysis, trials: list[Trial], values: Array) -> Array:
    """Return the total index (d,) of each parameter."""
    space = analysis.study.search_space()
    points = space.cube_of(trial.parameters for trial in trials)
    fit = coded_fit(GaussianProcess.fit, Coding(space.levels))
    rng = generator(analysis.study.seed, Stream.ACQUISITION, 2**31, len(trials))
    model = fit(points, values, rng=rng, minimum_length_scales=space.minimum_length_scales())
    return total_indices(lambda cube: model.predict_mean(space.repair(cube)), space.dimension)


def _importance(study: Study, shares: Mapping[str, Array]) -> Figure:
    """Show the share of each parameter as a bar, in a panel for each response."""
    titles = [study.parameters[name].title for name in study.search_space().names]
    places = list(range(len(titles)))
    panels = [
        Panel(
            title=response,
            x=Axis(label="", ticks=list(zip(places, titles, strict=True))),
            y=Axis(label="share", limits=(0.0, 1.0)),
            elements=[Bars(x=places, y=np.clip(totals, 0.0, 1.0), color=Color.BLUE, width=0.6)],
        )
        for response, totals in shares.items()
    ]
    return Figure(
        name="importance",
        title="Which parameter matters for what?",
        caption="Share of the variance over the search space that remains while the others are "
        "fixed.",
        alternative="; ".join(
            f"{response}: "
            + ", ".join(
                f"{title} {max(value, 0.0):.2f}"
                for title, value in zip(titles, totals, strict=True)
            )
            for response, totals in shares.items()
        ),
        panels=panels,
        columns=min(3, len(panels)),
        panel_height=190,
    )
