"""Convergence: every trial, and the incumbent after each."""

import itertools
import math
from collections.abc import Hashable, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np

from bo_tuner.figures.figure import (
    Axis,
    Color,
    Dash,
    Element,
    Figure,
    Limit,
    Line,
    Marker,
    Panel,
    Points,
    Scale,
)
from bo_tuner.models.fitting import FITTED_EACH
from bo_tuner.numerics.arrays import Array
from bo_tuner.optimizers.ranking import Candidate
from bo_tuner.report.analysis import Analysis, TrialOutcome
from bo_tuner.report.content import Section, numbered, quantity
from bo_tuner.storage.provenance import CARRIED, CARRIED_FROM
from bo_tuner.study.constraint import Constraint
from bo_tuner.study.limits import worst_case_holds
from bo_tuner.study.parts import Objective
from bo_tuner.study.study import Study
from bo_tuner.text import counted, values
from bo_tuner.trials import (
    TUNING,
    EvaluationState,
    Trial,
    TrialState,
    count_evaluations,
    count_trials,
)
from bo_tuner.tuning.summary import continued

MOST_INCUMBENTS = 40
"""The incumbent of a run of up to `FITTED_EACH` trials is computed at about so many points."""
GROWTH = 1.2
"""Ratio of the numbers of trials between two points of a longer run.

At even distances, the models of hundreds of trials would take most of the time of the report.
"""

LOOKS = {
    TrialOutcome.WITHIN: (Color.GREEN, Marker.CIRCLE, True),
    TrialOutcome.UNCERTAIN: (Color.SKY, Marker.CIRCLE, False),
    TrialOutcome.VIOLATES: (Color.ORANGE, Marker.TRIANGLE, False),
    TrialOutcome.OUTLIER: (Color.PURPLE, Marker.DIAMOND, False),
    TrialOutcome.FAILED: (Color.VERMILION, Marker.CROSS, False),
    TrialOutcome.LOST: (Color.GRAY, Marker.SQUARE, False),
    TrialOutcome.DISTURBED: (Color.GRAY, Marker.SQUARE, True),
    TrialOutcome.UNPREPARED: (Color.GRAY, Marker.DIAMOND, True),
}
"""Colour, marker and whether the marker is filled, by the outcome of a trial."""


def convergence(analysis: Analysis) -> Section:
    """Show the trials, and the incumbent over trials and over evaluations."""
    study, trials = analysis.study, analysis.record.trials
    complete = any(trial.state is TrialState.COMPLETE for trial in trials)
    figures = [_objective(analysis)] if complete else []
    if complete:
        figures += [
            _worst_case(analysis, constraint, numbered("worst-cases", k))
            for k, constraint in enumerate(study.worst_case_constraints)
        ]
    counts = [sum(analysis.outcome(t) == kind for t in analysis.trials) for kind in LOOKS]
    outcomes = ", ".join(f"{n} {kind}" for n, kind in zip(counts, LOOKS, strict=True) if n)
    evaluations = count_evaluations(trials)
    lead = f"{count_trials(trials)} of {study.budget.trials} trials in {evaluations} evaluations"
    if study.budget.evaluations is not None:
        lead += f" of {study.budget.evaluations}"
    return Section(
        name="convergence",
        title="Convergence",
        lead=f"{lead}: {outcomes}." if outcomes else f"{lead}.",
        figures=figures,
        notes=_notes(analysis),
    )


def describe(analysis: Analysis, trial: Trial) -> str:
    """Return some lines on a trial, to show when the pointer is on it."""
    study = analysis.study
    unit = study.metrics[study.objective.metric].unit
    lines = [
        f"trial {trial.number} ({trial.origin or 'unknown origin'}): {analysis.outcome(trial)}",
        values(analysis.tuned_values(trial.parameters)),
    ]
    if trial.state is TrialState.FAILED:
        return "\n".join([*lines, trial.reason])
    mean = analysis.mean_objective(trial)
    lines.append(f"mean {study.objective.metric} {quantity(mean, unit)}")
    for constraint in study.worst_case_constraints:
        worst = trial.worst_cases[constraint.name]
        found = quantity(worst.value, study.metrics[constraint.metric].unit)
        lines.append(f"worst {constraint.metric} {found} at {values(worst.context)}")
    return "\n".join(lines)


def _objective(analysis: Analysis) -> Figure:
    study, trials = analysis.study, analysis.trials
    y = mean_axis(study, study.objective)
    means = np.array([analysis.mean_objective(trial) for trial in trials])
    found = incumbents(analysis)
    line = "the posterior mean of the surrogate, which a single lucky sample hardly changes"
    if len(study.objectives) > 1:
        line = "the mean of its evaluations; it may rise where another objective gains more"
    shown = _within_sight(analysis, means, y.scale, study.objective.sign)
    edge = "top" if study.objective.sign > 0 else "bottom"
    worst = float(np.nanmax(shown) if study.objective.sign > 0 else np.nanmin(shown))
    evaluations = np.cumsum([len(trial.evaluations) for trial in analysis.record.trials])
    panels = [
        Panel(
            title=title,
            x=Axis(label=label),
            y=y,
            elements=[
                *_incumbent_lines(found, places, worst, study),
                *_default_line(analysis),
                *trial_points(analysis, analysis.trials, places, shown),
            ],
        )
        for title, label, places in (
            ("over trials", "trial", np.arange(len(trials), dtype=float)),
            ("over evaluations", "evaluations so far", evaluations.astype(float)),
        )
    ]
    return Figure(
        name="convergence",
        title=f"Mean {study.objective.metric} of each trial, and of the incumbent",
        caption="The incumbent is the parameter set that would be the result if the run ended "
        f"there; its line is {line}. Failed and lost trials, which have no value, and values far "
        f"worse than the others are at the {edge}, and so is the line.",
        alternative=_summary(analysis, found),
        panels=panels,
        columns=2,
    )


def _worst_case(analysis: Analysis, constraint: Constraint, name: str) -> Figure:
    study, sign = analysis.study, constraint.sign
    metric = study.metrics[constraint.metric]
    estimates = [t.worst_cases.get(constraint.name) for t in analysis.trials]
    found = np.array([math.nan if worst is None else worst.value for worst in estimates])
    shown = _within_sight(analysis, found, Scale.LINEAR, sign)
    within = sum(worst is not None and worst_case_holds(constraint, worst) for worst in estimates)
    edge, kept = ("top", "Below") if sign > 0.0 else ("bottom", "Above")
    side = f"{kept} the line the limit is kept"
    side += constraint.rule.note
    places = np.arange(len(found), dtype=float)
    return Figure(
        name=name,
        title=f"Worst {metric.name} found for each trial",
        caption=f"The {constraint.extreme} value over all contexts, as estimated by the search of "
        f"stage two. {side}. Failed and lost trials, and values far beyond are at the {edge}.",
        alternative=f"{within} of {len(found)} trials keep the limit of "
        f"{quantity(constraint.limit, metric.unit)}.",
        panels=[
            Panel(
                x=Axis(label="trial"),
                y=Axis(label=f"worst {metric.name}", unit=metric.unit),
                elements=[
                    Limit(value=constraint.limit, name="limit"),
                    *trial_points(analysis, analysis.trials, places, shown),
                ],
            )
        ],
        panel_height=280,
    )


def mean_axis(study: Study, objective: Objective) -> Axis:
    """Return the axis of the mean of an objective, on its scale."""
    return Axis(
        label=f"mean {objective.metric}",
        unit=study.metrics[objective.metric].unit,
        scale=Scale(objective.scale),
    )


def predicted_axis(study: Study) -> Axis:
    """Return the axis of what the surrogates predict for the objective, or for several."""
    if len(study.objectives) > 1:
        return Axis(label="cost of the compromise")
    return mean_axis(study, study.objective)


def outcome_points(
    analysis: Analysis, trials: Sequence[Trial], x: Array, y: Array, size: float = 7.0
) -> list[Element]:
    """Return a point for each trial at (x, y), by its outcome."""
    drawn: list[Element] = []
    outcomes = np.array([analysis.outcome(trial) for trial in trials])
    for kind, (color, marker, filled) in LOOKS.items():
        chosen = np.flatnonzero(outcomes == kind)
        if len(chosen):
            drawn.append(
                Points(
                    x=x[chosen],
                    y=y[chosen],
                    name=kind,
                    color=color,
                    marker=marker,
                    size=size,
                    filled=filled,
                    hover=[describe(analysis, trials[int(k)]) for k in chosen],
                )
            )
    return drawn


def trial_points(analysis: Analysis, trials: Sequence[Trial], x: Array, y: Array) -> list[Element]:
    """Return the `outcome_points`, and the mark of the result."""
    drawn = outcome_points(analysis, trials, x, y)
    answer = analysis.answer
    for k, trial in enumerate(trials):
        if answer is not None and trial.number == answer.number:
            drawn.append(
                Points(
                    x=[x[k]],
                    y=[y[k]],
                    name=analysis.answer_name,
                    color=Color.BLUE,
                    marker=Marker.STAR,
                    size=11,
                    hover=[describe(analysis, trial)],
                )
            )
    return drawn


def incumbents(analysis: Analysis) -> list[tuple[int, Candidate]]:
    """Return incumbents, each with the index of the last trial known at that point."""
    counts = _counts(len(analysis.record.trials))
    found = [(n - 1, analysis.remember(_key(n), partial(_incumbent, analysis, n))) for n in counts]
    return [(k, candidate) for k, candidate in found if candidate is not None]


def known_incumbents(found: Mapping[int, Candidate | None]) -> dict[Hashable, Any]:
    """Return what an `Analysis` may know of the incumbents that a run has found.

    Those of more than `FITTED_EACH` trials are left out: where a run has recorded no
    hyperparameters, they depend on the models of all trials.

    Parameters
    ----------
    found
        By the number of trials known then.
    """
    return {_key(count): candidate for count, candidate in found.items() if count <= FITTED_EACH}


def _key(count: int) -> Hashable:
    return "incumbent", count


def _counts(total: int) -> list[int]:
    """Return the numbers of trials to compute the incumbent after, the last one included.

    Most of them stay the same when a trial is added, so these incumbents are known already.
    """
    if total <= FITTED_EACH:
        step = max(1, -(-total // MOST_INCUMBENTS))
        return sorted({1, *range(step, total, step), total}) if total else []
    powers = itertools.takewhile(lambda n: n < total, (int(GROWTH**k) for k in itertools.count()))
    return sorted({*powers, total})


def _incumbent(analysis: Analysis, count: int) -> Candidate | None:
    """Return the incumbent after the first `count` trials.

    Beyond `FITTED_EACH` trials, the models have the hyperparameters that the run had then, or if it
    recorded none, as random search, those of all trials.
    """
    if count == len(analysis.record.trials) and not analysis.has_checks:
        return analysis.leader
    study, record = analysis.study, analysis.record
    method = record.method
    own = (k for k, e in enumerate(record.evaluations) if e.stage in TUNING and e.trial < count)
    # A run that was continued has repetitions between its trials.
    trials = continued(
        study,
        method,
        record.trials[:count],
        record.evaluations[: max(own, default=-1) + 1],
        stop_early=record.stop_early,
        finished=record.finished,
    )
    models = method.ranking.models(study, trials, analysis.models.warm_starts)
    return method.ranking.first_by(models, study, trials)


def _incumbent_lines(
    found: Sequence[tuple[int, Candidate]], x: Array, worst: float, study: Study
) -> list[Element]:
    """Return two lines up to the worst value shown: feasible and least violating incumbents."""
    within = min if study.objective.sign > 0 else max
    lines: list[Element] = []
    places = [x[k] for k, _ in found]
    for feasible, name, color, dash in (
        (True, "incumbent", Color.BLUE, Dash.SOLID),
        (False, "incumbent, not feasible", Color.GRAY, Dash.DOTTED),
    ):
        y = [
            within(c.objective, worst) if c.believed_feasible is feasible else math.nan
            for _, c in found
        ]
        if not np.all(np.isnan(y)):
            lines.append(
                Line(
                    x=places,
                    y=y,
                    name=name,
                    color=color,
                    dash=dash,
                    step=True,
                    hover=[f"{name}: trial {c.trial.number}" for _, c in found],
                )
            )
    return lines


def _default_line(analysis: Analysis) -> list[Element]:
    metric = analysis.study.objective.metric
    found = analysis.verdict.quantities
    values = [q.default for q in found if q.objective and q.metric == metric]
    if not values or math.isnan(values[0]):
        return []
    return [Limit(value=values[0], name="default", color=Color.INK, dash=Dash.DASH_DOT)]


def _within_sight(analysis: Analysis, seen: Array, scale: Scale, sign: float) -> Array:
    """Return the values (n,) with NaN and values far worse than the feasible ones at the edge.

    Large values are the worse ones, and the edge is the top; with a negative sign, the bottom.
    """
    if sign < 0:
        # Either is its own inverse.
        turned = np.reciprocal if scale is Scale.LOG else np.negative
        turned_back: Array = turned(_within_sight(analysis, turned(seen), scale, -sign))
        return turned_back
    good = [analysis.outcome(trial) == TrialOutcome.WITHIN for trial in analysis.trials]
    finite = np.isfinite(seen)
    if not finite.any():
        return np.ones(len(seen))
    chosen = seen[finite & good] if (finite & good).any() else seen[finite]
    low, high = float(seen[finite].min()), float(chosen.max())
    if scale is Scale.LOG and low > 0.0:
        top = high * max(high / low, 1.5)
    else:
        top = high + ((high - low) or abs(high) or 1.0)
    largest = float(seen[finite].max())
    if largest <= top:
        # No value is cropped, so the top is just above all.
        top = largest * 1.1 if scale is Scale.LOG else largest + 0.1 * (largest - low)
    return np.where(finite, np.minimum(seen, top), top)


def _summary(analysis: Analysis, found: Sequence[tuple[int, Candidate]]) -> str:
    unit = analysis.study.metrics[analysis.study.objective.metric].unit
    feasible = [(k, c) for k, c in found if c.believed_feasible]
    if not feasible:
        return "No trial is believed feasible, so there is no incumbent."
    (_, first), (_, last) = feasible[0], feasible[-1]
    return (
        f"The first feasible incumbent is trial {first.trial.number} with "
        f"{quantity(first.objective, unit)}, the last one trial {last.trial.number} with "
        f"{quantity(last.objective, unit)}."
    )


def _notes(analysis: Analysis) -> list[str]:
    notes = []
    total, provenance = len(analysis.record.trials), analysis.record.provenance
    if CARRIED in provenance:
        notes.append(f"Begins with {provenance[CARRIED]}, of {provenance[CARRIED_FROM]}.")
    if total > MOST_INCUMBENTS:
        points = len(_counts(total))
        text = f"The incumbent is shown at {points} points, not after each trial"
        if total > FITTED_EACH:
            text += (
                f", and beyond {FITTED_EACH} trials by models with hyperparameters that were not "
                "fitted anew at each of them"
            )
        notes.append(f"{text}.")
    if analysis.record.summary is not None and analysis.record.summary.get("stopped_early"):
        notes.append(
            "The run stopped early: the remaining trials were expected to gain less than the noise."
        )
    lost = sum(r.outcome.state is EvaluationState.LOST for r in analysis.record.evaluations)
    if lost:
        notes.append(f"Lost with their nodes: {counted(lost, 'evaluation')}.")
    return notes
