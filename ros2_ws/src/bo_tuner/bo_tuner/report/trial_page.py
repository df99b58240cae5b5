"""The page of a trial: its parameters, its evaluations and its signals."""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from math import isnan

from bo_tuner.errors import BackendError, RunRecordError, StudyError
from bo_tuner.figures.figure import Axis, Color, Dash, Figure, Line, Panel
from bo_tuner.recording.recorder import bag_name
from bo_tuner.recording.retention import evaluation_badness
from bo_tuner.recording.signal_bag import RecordedRun, recorded_runs
from bo_tuner.report.analysis import Analysis
from bo_tuner.report.content import Section, Table, number, quantity, values
from bo_tuner.report.sections.trajectories import (
    DEFAULT,
    LOOKS,
    TUNED,
    NoTraceError,
    panels,
    simulate,
)
from bo_tuner.trials import Evaluation, Trial
from bo_tuner.tuning.limits import verdict

MOST_POINTS = 2000
"""Largest number of points of a recorded signal in the page; longer signals are decimated."""


def trial_sections(analysis: Analysis, trial: Trial) -> list[Section]:
    """Return the sections of a trial's page.

    Parameters
    ----------
    analysis
        Of the run.
    trial
        One of its trials, with the evaluations that checked it.
    """
    return [_summary(analysis, trial), _signals(analysis, trial), _evaluations(analysis, trial)]


def _summary(analysis: Analysis, trial: Trial) -> Section:
    study = analysis.study
    metric = study.metrics[study.objective.metric]
    sentences = [f"{len(trial.evaluations)} evaluations; proposed as: {trial.origin or 'unknown'}."]
    if trial.reason:
        sentences.append(f"{trial.reason}.")
    mean = analysis.mean_objective(trial)
    if not isnan(mean):
        sentences.append(f"Mean {metric.name} {quantity(mean, metric.unit)}.")
    worst = study.worst_case_constraint
    if worst is not None and trial.worst_case is not None:
        unit = study.metrics[worst.metric].unit
        sentences.append(
            f"Worst {worst.metric} {quantity(trial.worst_case.value, unit)}, limit "
            f"{quantity(worst.upper, unit)}, at {values(trial.worst_case.context)}."
        )
    return Section(
        name="trial",
        title=f"Trial {trial.number}: {verdict(study, trial)}",
        lead=" ".join(sentences),
        tables=[
            Table(
                caption="Parameters",
                header=["parameter", "default", "this trial", "unit"],
                rows=[
                    [name, number(value), number(trial.parameters[name]), item.unit]
                    for (name, value), item in zip(
                        analysis.defaults.items(), study.parameters.values(), strict=True
                    )
                ],
                numeric=[1, 2],
            )
        ],
        notes=[f"While it was proposed: {warning}." for warning in trial.warnings],
    )


def _evaluations(analysis: Analysis, trial: Trial) -> Section:
    study = analysis.study
    contexts = list(study.context_space().names)
    header = ["evaluation", "stage", *contexts]
    header += [f"{m.name} [{m.unit}]" if m.unit else m.name for m in study.metrics.values()]
    header += ["seed", "time [s]", "state"]
    rows = [
        [
            str(item.index),
            str(item.stage),
            *(number(item.context[name]) for name in contexts),
            *(number(item.outcome.metrics.get(name)) for name in study.metrics),
            str(item.seed),
            number(item.seconds),
            _state(item),
        ]
        for item in trial.evaluations
    ]
    worst = _worst(analysis, trial)
    return Section(
        name="evaluations",
        title="Evaluations",
        lead="In the order in which they ran; the worst one is marked.",
        tables=[
            Table(
                caption=f"{len(rows)} evaluations",
                header=header,
                rows=rows,
                numeric=[0, *range(2, len(header) - 1)],
                sortable=True,
                marked=[k for k, item in enumerate(trial.evaluations) if item is worst],
            )
        ],
    )


def _state(item: Evaluation) -> str:
    state = str(item.outcome.state)
    return f"{state}: {item.outcome.reason}" if item.outcome.reason else state


def _worst(analysis: Analysis, trial: Trial) -> Evaluation | None:
    badness = partial(evaluation_badness, analysis.study)
    return max(trial.evaluations, key=badness, default=None)


def _signals(analysis: Analysis, trial: Trial) -> Section:
    """Show the signals of the worst evaluation: from its bag, or else simulated again."""
    worst = _worst(analysis, trial)
    if worst is None:
        return Section(name="signals", title="Signals", lead="The trial has no evaluation.")
    where = f"evaluation {worst.index}, the worst one ({values(worst.context) or 'no context'})"
    try:
        recorded = _recorded(analysis, worst)
        if recorded is not None:
            figure = _of_bag(recorded)
            lead = f"Recorded in bags/{recorded.bag}: {where}."
        else:
            figure = _again(analysis, worst, f"trial {trial.number}")
            lead = (
                f"Simulated again in process by the study's objects, not recorded: {where}, beside "
                "the default in the same context with the same noise."
            )
            bag = f"bags/{bag_name(worst)}"
            if (analysis.record.path / bag).is_dir():
                lead += f" The messages of the trial are in {bag}."
    except (NoTraceError, StudyError, BackendError, RunRecordError) as error:
        return Section(name="signals", title="Signals", lead=f"No signals: {error}.")
    return Section(name="signals", title="Signals", lead=lead, figures=[figure])


def _recorded(analysis: Analysis, wanted: Evaluation) -> RecordedRun | None:
    """Return the recorded signals of an evaluation; None if no bag has them."""
    folder = analysis.record.path / "bags"
    name = bag_name(wanted)
    for bag in sorted((*folder.glob(name), *folder.glob(f"{name}_part*"))):
        for run in recorded_runs(bag):
            if run.trial == wanted.trial and run.evaluation.get("index") == wanted.index:
                return run
    return None


def _of_bag(run: RecordedRun) -> Figure:
    drawn = []
    for name, seen in run.recording.signals.items():
        step = max(1, -(-len(seen.time) // MOST_POINTS))
        drawn.append(
            Panel(
                x=Axis(label="time", unit="s"),
                y=Axis(label=name),
                elements=[
                    Line(
                        x=seen.time[::step],
                        y=seen.value[::step],
                        name="recorded",
                        color=Color.BLUE,
                        dash=Dash.SOLID,
                        width=1.5,
                        step=True,
                    )
                ],
            )
        )
    return _figure(drawn, "As the tuner heard them; each value holds until the next message.")


def _again(analysis: Analysis, worst: Evaluation, name: str) -> Figure:
    default = replace(worst, parameters=analysis.defaults)
    of_default, of_trial = simulate(analysis.study, [default, worst])
    looks = {DEFAULT: LOOKS[DEFAULT], name: LOOKS[TUNED]}
    drawn = panels({"": {DEFAULT: of_default, name: of_trial}}, looks)
    return _figure(drawn, "Drag across a panel to zoom in; double-click to zoom out.")


def _figure(drawn: Sequence[Panel], caption: str) -> Figure:
    return Figure(
        name="signals",
        title="Signals of the worst evaluation",
        caption=caption,
        alternative=f"{len(drawn)} signals over time.",
        panels=drawn,
        panel_height=260,
    )
