"""Sensitivity of the tuned parameter set to a step in one parameter."""

import numpy as np

from bo_tuner.evidence.certificate.parameter_sensitivity import (
    Neighbour,
    ParameterSensitivity,
    parameter_sensitivity,
)
from bo_tuner.figures.figure import Axis, Bars, Color, Figure, Panel
from bo_tuner.models.constraints import BELIEVED_FEASIBLE
from bo_tuner.optimizers.ranking import TOLERABLE
from bo_tuner.report.analysis import Analysis
from bo_tuner.report.content import Section, Table, change, number
from bo_tuner.report.sections.convergence import predicted_axis
from bo_tuner.study.search_space import STEP
from bo_tuner.text import shown
from bo_tuner.trials import Value


def sensitivity(analysis: Analysis) -> Section | None:
    """Show the predictions one step away from the answer; None while there is no answer."""
    if analysis.answer is None:
        return None
    study = analysis.study
    found = parameter_sensitivity(study, analysis.answer.parameters, analysis.models)
    if found is None or not found.neighbours:
        return None
    axis = predicted_axis(study)
    optimum = found.optimum
    rows = [
        [
            _step(neighbour, optimum) if neighbour is not optimum else analysis.answer_name,
            number(neighbour.objective),
            change(neighbour.objective, optimum.objective) if neighbour is not optimum else "",
            f"{100.0 * neighbour.feasibility:.0f} %",
            "yes" if neighbour.tolerable and neighbour.feasibility >= BELIEVED_FEASIBLE else "no",
        ]
        for neighbour in (optimum, *found.neighbours)
    ]
    lost = [
        _step(n, optimum)
        for n in found.neighbours
        if n.feasibility < BELIEVED_FEASIBLE <= optimum.feasibility
    ]
    tolerable = (
        f"None of {len(found.neighbours)} steps to a neighbour loses more than "
        f"{100.0 * TOLERABLE:.0f} % of the objective or exceeds a limit by more than that."
    )
    lead = found.warning[:1].upper() + found.warning[1:] + "." if found.warning else tolerable
    if lost:
        lead += f" Steps to a parameter set believed infeasible: {', '.join(lost)}."
    return Section(
        name="sensitivity",
        title="Sensitivity to a step in one parameter",
        lead=lead,
        figures=[_figure(analysis, found, axis)],
        tables=[
            Table(
                caption="Predictions of the surrogates one step away from the "
                f"{analysis.answer_set}",
                header=[
                    "step",
                    axis.title,
                    "change",
                    "P(feasible)",
                    "tolerable",
                ],
                rows=rows,
                numeric=[1, 2, 3],
            )
        ],
        notes=[
            "A step is tolerable if the parameter set there is believed feasible, and neither loss "
            f"nor excess is above {100.0 * TOLERABLE:.0f} %. "
            f"A step is 1 for an integer and {100.0 * STEP:g} % of the range for a double. The "
            f"sensitivity score, the mean loss beyond {100.0 * TOLERABLE:.0f} %, is "
            f"{found.score:.3g}."
        ],
    )


def _figure(analysis: Analysis, found: ParameterSensitivity, axis: Axis) -> Figure:
    optimum = found.optimum
    steps = [_step(n, optimum) for n in found.neighbours]
    objectives = np.array([n.objective for n in found.neighbours])
    if optimum.objective > 0.0:
        unit, form = "%", "+.1f"
        changes = 100.0 * (objectives / optimum.objective - 1.0)
    else:  # A percentage of it would say nothing; the table has a dash.
        unit, form = axis.unit, "+.3g"
        changes = objectives - optimum.objective
    told = [f"{s}: {c:{form}} {unit}".rstrip() for s, c in zip(steps, changes, strict=True)]
    kept = np.array([n.feasibility >= BELIEVED_FEASIBLE for n in found.neighbours])
    places = np.arange(len(steps), dtype=float)
    bars = [
        Bars(
            x=places[chosen],
            y=changes[chosen],
            base=np.zeros(int(chosen.sum())),
            name=name,
            color=color,
            hover=[
                f"{told[k]}\nP(feasible) {found.neighbours[k].feasibility:.2f}"
                for k in np.flatnonzero(chosen)
            ],
        )
        for name, color, chosen in (
            ("believed feasible", Color.GREEN, kept),
            ("believed infeasible", Color.ORANGE, ~kept),
        )
        if chosen.any()
    ]
    return Figure(
        name="sensitivity",
        title=f"Change of the {axis.label} one step away from the {analysis.answer_set}",
        caption="Predicted by the surrogates. A gain at an infeasible neighbour means that a limit "
        "is active at the optimum; large losses on both sides mean that the optimum is narrow.",
        alternative="; ".join(told),
        panels=[
            Panel(
                x=Axis(label="", ticks=list(zip(places.tolist(), steps, strict=True))),
                y=Axis(label=f"change of the {axis.label}", unit=unit),
                elements=bars,
            )
        ],
        panel_height=300,
    )


def _step(neighbour: Neighbour, optimum: Neighbour) -> str:
    return ", ".join(
        _change(name, optimum.parameters[name], value) for name, value in neighbour.changed.items()
    )


def _change(name: str, old: Value, new: Value) -> str:
    if isinstance(old, (bool, str)) or isinstance(new, (bool, str)):
        return f"{name} {shown(new)}"
    difference = new - old
    return f"{name} {difference:+d}" if isinstance(difference, int) else f"{name} {difference:+.3g}"
