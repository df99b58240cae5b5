"""The page that compares two trials of one run."""

from collections.abc import Mapping
from dataclasses import replace

from bo_tuner.errors import BackendError, RunRecordError, StudyError
from bo_tuner.evidence.trial_row import trial_row
from bo_tuner.evidence.words.trials import outcome
from bo_tuner.figures.figure import Figure, Panel
from bo_tuner.report.analysis import Analysis
from bo_tuner.report.comparison import LINES, Cell, Row, side_by_side
from bo_tuner.report.content import Section, number
from bo_tuner.report.recorded_signals import recorded, signal_panels
from bo_tuner.report.sections.trajectories import NoTraceError, panels, simulate
from bo_tuner.report.trial_page import worst_run
from bo_tuner.study.titles import mean_title
from bo_tuner.text import capitalized, values
from bo_tuner.trials import Trial


def two_trials(analysis: Analysis, one: Trial, other: Trial) -> list[Section]:
    """Return the sections of the page."""
    trials = {f"trial {trial.number}": trial for trial in (one, other)}
    study = analysis.study
    outcomes = [f"{name}: {outcome(trial_row(study, trial))}" for name, trial in trials.items()]
    return [
        Section(
            name="parameters",
            title="Parameters",
            lead=capitalized("; ".join(outcomes)) + ".",
            tables=[
                side_by_side(
                    "Parameter sets", {n: _parameters(analysis, t) for n, t in trials.items()}
                )
            ],
        ),
        Section(
            name="numbers",
            title="Numbers",
            lead="By the test runs of each trial alone, which are in other contexts with other "
            "noise: part of a difference is chance.",
            tables=[side_by_side("Metrics", {n: _numbers(analysis, t) for n, t in trials.items()})],
        ),
        _signals(analysis, trials),
    ]


def _parameters(analysis: Analysis, trial: Trial) -> dict[Row, Cell]:
    parameters = analysis.study.on_screen(trial.parameters)
    return {
        (item.title_and_name, item.unit): (number(parameters[name]), parameters[name])
        for name, item in analysis.study.parameters.items()
    }


def _numbers(analysis: Analysis, trial: Trial) -> dict[Row, Cell]:
    """Return means over drawn contexts, and the worst cases that are held against limits."""
    found: dict[Row, Cell] = {}
    for name, metric in analysis.study.metrics.items():
        if (mean := trial.mean(name)) is not None:
            found[mean_title(metric.title), metric.unit] = number(mean), mean
    for constraint in analysis.study.worst_case_constraints:
        if (worst := trial.worst_cases.get(constraint.name)) is not None:
            metric = analysis.study.metrics[constraint.metric]
            found[f"worst {metric.title}", metric.unit] = number(worst.value), worst.value
    return found


def _signals(analysis: Analysis, trials: Mapping[str, Trial]) -> Section:
    """Show both in the worst context of the first: simulated, or what is recorded of each."""
    try:
        drawn, lead = _drawn(analysis, trials)
    except (NoTraceError, StudyError, BackendError, RunRecordError) as error:
        return Section(name="signals", title="Signals", lead=f"No signals: {error}.")
    figure = Figure(
        name="signals",
        title="What does each do?",
        caption="Drag across a panel to zoom in; double-click to zoom out.",
        alternative=f"Signals over time of {' and '.join(trials)}.",
        panels=drawn,
        panel_height=260,
    )
    return Section(name="signals", title="Signals", lead=lead, figures=[figure])


def _drawn(analysis: Analysis, trials: Mapping[str, Trial]) -> tuple[list[Panel], str]:
    styles = {name: (color, dash) for name, (dash, color) in zip(trials, LINES, strict=False)}
    worst = {name: worst_run(analysis, trial) for name, trial in trials.items()}
    found = {name: run for name, run in worst.items() if run is not None}
    if len(found) < len(trials):
        raise NoTraceError("a trial has no test run")
    bags = {name: recorded(analysis, run) for name, run in found.items()}
    of_bags = {name: bag for name, bag in bags.items() if bag is not None}
    if len(of_bags) == len(trials):
        drawn = signal_panels(analysis.study, of_bags, styles)
        return drawn, "Recorded: the worst test run of each, each in a context of its own."
    first, *_ = found.values()
    planned = [replace(first, parameters=trial.parameters) for trial in trials.values()]
    traces = dict(zip(trials, simulate(analysis.study, planned), strict=True))
    where = values(first.context) or "no context"
    lead = f"Simulated by the study's objects with the same noise, in one context: {where}."
    return panels({"": traces}, styles, analysis.study), lead
