"""Convergence: every trial, and the best so far (incumbent) after each."""

import itertools
import math
from collections.abc import Mapping, Sequence
from functools import partial

import numpy as np
from numpy.typing import NDArray

from bo_tuner.evidence.trial_row import TrialOutcome
from bo_tuner.evidence.words.limit_kinds import words_of
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
from bo_tuner.report.analysis import Analysis, Known, remembered
from bo_tuner.report.content import Section, number, numbered, quantity
from bo_tuner.report.marks import DEFAULT, OFF_SCALE, OVER_LIMIT, RESULT
from bo_tuner.storage.provenance import (
    CARRIED,
    CARRIED_FROM,
    SIMULATION_FROM,
    SIMULATION_TAKEN,
)
from bo_tuner.study.constraint import Constraint
from bo_tuner.study.limits import decisive, worst_case_holds
from bo_tuner.study.parts import Objective
from bo_tuner.study.study import Study
from bo_tuner.study.titles import mean_title
from bo_tuner.text import capitalized, counted, values
from bo_tuner.trials import (
    TUNING,
    EvaluationState,
    Trial,
    TrialState,
    count_evaluations,
    count_trials,
)
from bo_tuner.tuning.recorded_method import recorded_method
from bo_tuner.tuning.summary import continued

MOST_INCUMBENTS = 40
"""Points at which the incumbent of a run of up to `FITTED_EACH` trials is computed, about."""
GROWTH = 1.2
"""Ratio of the numbers of trials between two points of a longer run.

At even distances, the models of hundreds of trials would take most of the time of the report.
"""

STYLES = {
    TrialOutcome.WITHIN: (Color.GREEN, Marker.CIRCLE, True),
    TrialOutcome.UNCERTAIN: (Color.SKY, Marker.CIRCLE, False),
    TrialOutcome.VIOLATES: (*OVER_LIMIT, False),
    TrialOutcome.OUTLIER: (Color.PURPLE, Marker.DIAMOND, False),
    TrialOutcome.CUT_SHORT: (*OVER_LIMIT, True),
    TrialOutcome.FAILED: (Color.VERMILION, Marker.CROSS, False),
    TrialOutcome.LOST: (Color.GRAY, Marker.SQUARE, False),
    TrialOutcome.DISTURBED: (Color.GRAY, Marker.SQUARE, True),
    TrialOutcome.UNPREPARED: (Color.GRAY, Marker.DIAMOND, True),
    TrialOutcome.WITHDRAWN: (Color.GRAY, Marker.CROSS, True),
}
"""Colour, marker and whether the marker is filled, by the outcome of a trial."""


def convergence(analysis: Analysis) -> Section:
    """Show the trials, and the best so far after each."""
    study, trials = analysis.study, analysis.record.trials
    complete = any(trial.state is TrialState.COMPLETE for trial in trials)
    figures = [_objective(analysis)] if complete else []
    if complete:
        figures += [
            _worst_case(analysis, constraint, numbered("worst-cases", k))
            for k, constraint in enumerate(study.worst_case_constraints)
        ]
    counts = [sum(analysis.outcome(t) == kind for t in analysis.trials) for kind in STYLES]
    outcomes = ", ".join(f"{n} {kind}" for n, kind in zip(counts, STYLES, strict=True) if n)
    planned = counted(study.budget.trials, "trial")
    lead = f"{count_trials(trials)} of {planned}, in {_test_runs(analysis)}"
    return Section(
        name="convergence",
        title="How far has it come?",
        lead=f"{lead}: {outcomes}." if outcomes else f"{lead}.",
        figures=figures,
        notes=_notes(analysis),
    )


def _test_runs(analysis: Analysis) -> str:
    evaluations = count_evaluations(analysis.record.trials)
    text = counted(evaluations, "test run")
    budget = analysis.study.budget.evaluations
    return text if budget is None else f"{text} of {budget}"


def describe(analysis: Analysis, trial: Trial) -> str:
    """Return some lines on a trial, to show when the pointer is on it."""
    study = analysis.study
    unit = study.metrics[study.objective.metric].unit
    lines = [
        f"trial {trial.number} ({trial.origin or 'unknown origin'}): {analysis.outcome(trial)}",
        analysis.tuned_in_words(trial.parameters),
    ]
    if trial.state is not TrialState.COMPLETE:
        return "\n".join([*lines, trial.reason])
    mean = analysis.estimate(trial, study.objective.metric)
    title = mean_title(study.metrics[study.objective.metric].title)
    lines.append(f"{title} {quantity(mean.value, unit)} ({mean.kind})")
    for constraint in study.worst_case_constraints:
        worst = trial.worst_cases[constraint.name]
        metric = study.metrics[constraint.metric]
        estimate = quantity(worst.value, metric.unit)
        lines.append(f"worst {metric.title} {estimate} at {values(worst.context)}")
    return "\n".join(lines)


def _objective(analysis: Analysis) -> Figure:
    study, trials = analysis.study, analysis.trials
    y, sign = mean_axis(study, study.objective), study.objective.sign
    means = np.array([analysis.estimate(t, study.objective.metric).value for t in trials])
    best_by_trial = incumbents(analysis)
    default = _default_line(analysis)
    edge = scale_end(_good(analysis), means, y.scale, sign, [limit.value for limit in default])
    places = np.arange(len(trials), dtype=float)
    far = _off_scale(analysis, places, means, edge, sign)
    return Figure(
        name="convergence",
        title=f"Would more trials help? {capitalized(y.label)} of each trial, and of the best "
        "so far",
        caption=f"Means {analysis.means_in_words}. {_edge_in_words(sign)}",
        alternative=_summary(analysis, best_by_trial),
        panels=[
            Panel(
                x=Axis(label="trial"),
                y=y,
                elements=[
                    *_incumbent_lines(best_by_trial, places, edge, study),
                    *default,
                    *trial_points(analysis, trials, places, on_scale(means, edge, sign)),
                    *far,
                ],
            )
        ],
        panel_height=320,
    )


def _worst_case(analysis: Analysis, constraint: Constraint, name: str) -> Figure:
    """Show what the limit is held against: the mean in the worst context, or a quantile there."""
    sign, metric = constraint.sign, analysis.study.metrics[constraint.metric]
    estimates = [t.worst_cases.get(constraint.name) for t in analysis.trials]
    decisive_values = np.array(
        [math.nan if worst is None else decisive(constraint, worst) for worst in estimates]
    )
    edge = scale_end(_good(analysis), decisive_values, Scale.LINEAR, sign, [constraint.limit])
    within = sum(worst is not None and worst_case_holds(constraint, worst) for worst in estimates)
    label, side = f"worst {metric.title}", "below" if sign > 0.0 else "above"
    if constraint.rule.on_runs:
        level = constraint.level if sign > 0.0 else constraint.allowed
        label = f"worst {level:.4g} quantile of {metric.title}"
    places = np.arange(len(decisive_values), dtype=float)
    return Figure(
        name=name,
        title=f"Which trials stay within the limit of {metric.title} in their worst context?",
        caption=f"{words_of(constraint).decisive}; {side} the line the limit is kept. "
        f"{_edge_in_words(sign)}",
        alternative=f"Within the limit of {quantity(constraint.limit, metric.unit)}: {within} of "
        f"{counted(len(decisive_values), 'trial')}.",
        panels=[
            Panel(
                x=Axis(label="trial"),
                y=Axis(label=label, unit=metric.unit),
                elements=[
                    Limit(value=constraint.limit, name="limit"),
                    *trial_points(
                        analysis, analysis.trials, places, on_scale(decisive_values, edge, sign)
                    ),
                    *_off_scale(analysis, places, decisive_values, edge, sign),
                ],
            )
        ],
        panel_height=280,
    )


def _edge_in_words(sign: float) -> str:
    edge, beyond = ("top", "above") if sign > 0.0 else ("bottom", "below")
    return (
        f"At the {edge}: failed and lost trials, which have no value, and with a mark of their own "
        f"values that are off the scale, {beyond} it."
    )


def mean_axis(study: Study, objective: Objective) -> Axis:
    """Return the axis of the mean of an objective, on its scale."""
    return Axis(
        label=mean_title(study.metrics[objective.metric].title),
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
    return points_by_outcome(
        [analysis.outcome(trial) for trial in trials],
        x,
        y,
        size,
        hover=[describe(analysis, trial) for trial in trials],
        trials=[trial.number for trial in trials],
    )


def points_by_outcome(
    outcomes: Sequence[TrialOutcome],
    x: Array,
    y: Array,
    size: float = 7.0,
    *,
    hover: Sequence[str] = (),
    trials: Sequence[int] = (),
) -> list[Element]:
    """Return points (x, y) by the outcomes of their trials, with texts and numbers if given."""
    drawn: list[Element] = []
    kinds = np.array(outcomes)
    for kind, (color, marker, filled) in STYLES.items():
        chosen = np.flatnonzero(kinds == kind)
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
                    hover=[hover[int(k)] for k in chosen] if hover else (),
                    trials=[trials[int(k)] for k in chosen] if trials else (),
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
                    color=RESULT[0],
                    marker=RESULT[1],
                    size=11,
                    hover=[describe(analysis, trial)],
                    trials=[trial.number],
                )
            )
    return drawn


def incumbents(analysis: Analysis) -> list[tuple[int, Candidate]]:
    """Return incumbents, each with the index of the last trial known at that point."""
    counts = _counts(len(analysis.record.trials))
    known = analysis.known.incumbents
    candidates = [(n - 1, remembered(known, n, partial(_incumbent, analysis, n))) for n in counts]
    return [(k, candidate) for k, candidate in candidates if candidate is not None]


def known_incumbents(incumbents_by_count: Mapping[int, Candidate | None]) -> Known:
    """Return what an `Analysis` may know of the incumbents that a run has found.

    Those of more than `FITTED_EACH` trials are left out: where a run has recorded no
    hyperparameters, they depend on the models of all trials.
    """
    return Known(
        {count: best for count, best in incumbents_by_count.items() if count <= FITTED_EACH}
    )


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
    method = recorded_method(record)
    own = (k for k, e in enumerate(record.evaluations) if e.stage in TUNING and e.trial < count)
    # A run that was continued has repetitions between its trials.
    trials = continued(
        study,
        method,
        record.trials[:count],
        record.evaluations[: max(own, default=-1) + 1],
        stop_early=record.options.stop_early,
        finished=record.finished,
    )
    models = method.ranking.models(study, trials, analysis.models.warm_starts)
    return method.ranking.first_by(models, study, trials)


def _incumbent_lines(
    best_by_trial: Sequence[tuple[int, Candidate]], x: Array, worst: float, study: Study
) -> list[Element]:
    """Return two lines up to the worst value shown: feasible and least violating incumbents."""
    within = min if study.objective.sign > 0 else max
    lines: list[Element] = []
    places = [x[k] for k, _ in best_by_trial]
    for feasible, name, color, dash in (
        (True, "best so far", RESULT[0], Dash.SOLID),
        (False, "best so far, not likely within limits", Color.GRAY, Dash.DOTTED),
    ):
        y = [
            within(c.objective, worst) if c.believed_feasible is feasible else math.nan
            for _, c in best_by_trial
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
                    hover=[f"{name}: trial {c.trial.number}" for _, c in best_by_trial],
                    trials=[c.trial.number for _, c in best_by_trial],
                )
            )
    return lines


def _default_line(analysis: Analysis) -> list[Limit]:
    metric = analysis.study.objective.metric
    quantities = analysis.verdict.quantities
    values = [q.default for q in quantities if q.objective and q.metric == metric]
    if not values or math.isnan(values[0]):
        return []
    return [Limit(value=values[0], name="default", color=DEFAULT[0], dash=Dash.DASH_DOT)]


def _good(analysis: Analysis) -> list[bool]:
    return [analysis.outcome(trial) == TrialOutcome.WITHIN for trial in analysis.trials]


def scale_end(
    good: Sequence[bool], seen: Array, scale: Scale, sign: float, lines: Sequence[float]
) -> float:
    """Return the end of the scale on the side of the worse values."""
    if sign < 0:
        # Either is its own inverse.
        turned = np.reciprocal if scale is Scale.LOG else np.negative
        others = [float(turned(np.float64(line))) for line in lines]
        return float(turned(scale_end(good, turned(seen), scale, -sign, others)))
    finite = np.isfinite(seen)
    if not finite.any():
        return max([1.0, *lines])
    chosen = seen[finite & good] if (finite & good).any() else seen[finite]
    low, high = float(seen[finite].min()), max([float(chosen.max()), *lines])
    if scale is Scale.LOG and low > 0.0:
        top = high * max(high / low, 1.5)
    else:
        top = high + ((high - low) or abs(high) or 1.0)
    largest = max([float(seen[finite].max()), *lines])
    if largest <= top:
        # No value is cropped, so the top is just above all.
        top = largest * 1.1 if scale is Scale.LOG else largest + 0.1 * (largest - low)
    return top


def beyond(values: Array, edge: float, sign: float) -> NDArray[np.bool_]:
    """Return which values (n,) are off the scale."""
    is_beyond: NDArray[np.bool_] = sign * values > sign * edge
    return is_beyond


def on_scale(values: Array, edge: float, sign: float) -> Array:
    """Return the values (n,): those that are missing are at the edge, those beyond are NaN."""
    return np.where(
        np.isfinite(values), np.where(beyond(values, edge, sign), math.nan, values), edge
    )


def _off_scale(
    analysis: Analysis, places: Array, values: Array, edge: float, sign: float
) -> list[Element]:
    """Return a mark at the edge for each trial with a value beyond, named with the farthest."""
    far = np.flatnonzero(beyond(values, edge, sign))
    if not len(far):
        return []
    farthest = values[far].max() if sign > 0.0 else values[far].min()
    return [
        Points(
            x=places[far],
            y=np.full(len(far), edge),
            name=f"off the scale, to {number(float(farthest))}",
            color=OFF_SCALE[0],
            marker=OFF_SCALE[1],
            size=9,
            hover=[
                f"off the scale: {number(float(values[k]))}\n"
                f"{describe(analysis, analysis.trials[k])}"
                for k in far
            ],
            trials=[analysis.trials[k].number for k in far],
        )
    ]


def _summary(analysis: Analysis, best_by_trial: Sequence[tuple[int, Candidate]]) -> str:
    unit = analysis.study.metrics[analysis.study.objective.metric].unit
    feasible = [(k, c) for k, c in best_by_trial if c.believed_feasible]
    if not feasible:
        return "No trial is likely within limits."
    (_, first), (_, last) = feasible[0], feasible[-1]
    return (
        f"The first that was likely within limits is trial {first.trial.number} with "
        f"{quantity(first.objective, unit)}, the last best one trial {last.trial.number} with "
        f"{quantity(last.objective, unit)}."
    )


def _notes(analysis: Analysis) -> list[str]:
    notes = []
    total, provenance = len(analysis.record.trials), analysis.record.provenance
    if CARRIED in provenance:
        notes.append(f"Begins with {provenance[CARRIED]}, of {provenance[CARRIED_FROM]}.")
    if SIMULATION_TAKEN in provenance:
        known, run = provenance[SIMULATION_TAKEN], provenance[SIMULATION_FROM]
        notes.append(f"Knows {known}, of the simulation {run}.")
    if total > MOST_INCUMBENTS:
        points = len(_counts(total))
        text = f"The best so far is shown at {points} points, not after each trial"
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
        notes.append(f"Lost with their nodes: {counted(lost, 'test run')}.")
    return notes
