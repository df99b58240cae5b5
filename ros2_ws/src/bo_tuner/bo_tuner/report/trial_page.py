"""The page of a trial: its parameters, its evaluations and its signals."""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

from bo_tuner.errors import BackendError, RunRecordError, StudyError
from bo_tuner.evidence.trial_row import OF_VALUE, trial_row
from bo_tuner.evidence.words import trials as words
from bo_tuner.evidence.words.verdict import headline
from bo_tuner.figures.figure import Figure, Panel
from bo_tuner.recording.retention import evaluation_badness
from bo_tuner.report.analysis import Analysis
from bo_tuner.report.content import Section, Table, number, quantity
from bo_tuner.report.recorded_signals import recorded, signal_panels
from bo_tuner.report.sections.trajectories import (
    STYLES,
    NoTraceError,
    panels,
    side_styles,
    simulate,
)
from bo_tuner.storage.run_files import BAGS, bag_name
from bo_tuner.study.titles import mean_title
from bo_tuner.text import capitalized, counted, values, with_unit
from bo_tuner.trials import DEFAULT, TUNED, Evaluation, Trial


def trial_sections(analysis: Analysis, trial: Trial) -> list[Section]:
    """Return the sections of a trial's page."""
    return [_summary(analysis, trial), _signals(analysis, trial), _evaluations(analysis, trial)]


def _summary(analysis: Analysis, trial: Trial) -> Section:
    study, of_run = analysis.study, analysis.verdict
    own, title = _in_words(analysis, trial), f"Trial {trial.number}"
    defaults, parameters = map(study.on_screen, (analysis.defaults, trial.parameters))
    count = counted(len(trial.evaluations), "test run")
    sentences = [f"{count}; proposed as: {trial.origin or 'unknown'}."]
    if trial.number == of_run.trial:
        # What its own evaluations say may differ from what fresh ones showed.
        title += f", the result. {headline(of_run)}"
        sentences.append(f"By its own test runs alone: {own}.")
    else:
        title += f": {own}"
    if trial.reason:
        sentences.append(f"{trial.reason}.")
    for objective in study.objectives:
        metric = study.metrics[objective.metric]
        estimates = (
            analysis.fresh_estimate(trial, metric.name),
            analysis.estimate(trial, metric.name),
        )
        known = [
            f"{quantity(each.value, metric.unit)} ({each.kind})"
            for each in estimates
            if each is not None and each.count
        ]
        if known:
            sentences.append(capitalized(f"{mean_title(metric.title)} {', '.join(known)}."))
    for constraint in study.worst_case_constraints:
        if (worst := trial.worst_cases.get(constraint.name)) is not None:
            metric = study.metrics[constraint.metric]
            sentences.append(
                f"Worst {metric.title} {quantity(worst.value, metric.unit)}, limit "
                f"{quantity(constraint.limit, metric.unit)}, at {values(worst.context)}."
            )
    return Section(
        name="trial",
        title=title,
        lead=" ".join(sentences),
        tables=[
            Table(
                caption="Parameters",
                header=["parameter", "default", "this trial", "unit"],
                rows=[
                    [
                        item.title_and_name,
                        number(value),
                        number(parameters[name]),
                        item.unit,
                    ]
                    for (name, value), item in zip(
                        defaults.items(), study.parameters.values(), strict=True
                    )
                ],
                numeric=[1, 2],
            )
        ],
        notes=[f"While it was proposed: {warning}." for warning in trial.warnings],
    )


def _in_words(analysis: Analysis, trial: Trial) -> str:
    """Return the outcome of a trial; of limits that it may not keep the names, too."""
    outcome = analysis.outcome(trial)
    return words.outcome(trial_row(analysis.study, trial)) if outcome in OF_VALUE else str(outcome)


def _evaluations(analysis: Analysis, trial: Trial) -> Section:
    study = analysis.study
    contexts = list(study.context_space().names)
    header = ["test run", "stage", *contexts]
    header += [with_unit(m.title, m.unit) for m in study.metrics.values()]
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
    worst = worst_run(analysis, trial)
    return Section(
        name="test-runs",
        title="Test runs",
        lead="In the order in which they ran; the worst one is marked.",
        tables=[
            Table(
                caption=counted(len(rows), "test run"),
                header=header,
                rows=rows,
                numeric=[0, *range(2, len(header) - 1)],
                sortable=True,
                marked=[k for k, item in enumerate(trial.evaluations) if item is worst],
            )
        ],
    )


def _state(item: Evaluation) -> str:
    state = item.outcome.ending
    remark = item.outcome.reason or item.outcome.notes.remark
    return f"{state}: {remark}" if remark else state


def worst_run(analysis: Analysis, trial: Trial) -> Evaluation | None:
    """Return the worst test run of a trial; None without any."""
    badness = partial(evaluation_badness, analysis.study)
    return max(trial.evaluations, key=badness, default=None)


def _signals(analysis: Analysis, trial: Trial) -> Section:
    """Show the signals of the worst evaluation: from its bag, or else simulated again."""
    worst = worst_run(analysis, trial)
    if worst is None:
        return Section(name="signals", title="Signals", lead="The trial has no test run.")
    where = f"test run {worst.index}, the worst one ({values(worst.context) or 'no context'})"
    try:
        run = recorded(analysis, worst)
        if run is not None:
            figure = _figure(
                signal_panels(analysis.study, {"recorded": run}, {"recorded": STYLES[TUNED]}),
                "As received by the tuner; each value holds until the next message.",
            )
            lead = f"Recorded in {BAGS}/{run.bag}: {where}."
        else:
            figure = _again(analysis, worst, f"trial {trial.number}")
            lead = (
                f"Simulated again in process by the study's objects, not recorded: {where}, beside "
                "the default in the same context with the same noise."
            )
            bag = f"{BAGS}/{bag_name(worst)}"
            if (analysis.record.path / bag).is_dir():
                lead += f" The messages of the trial are in {bag}."
    except (NoTraceError, StudyError, BackendError, RunRecordError) as error:
        return Section(name="signals", title="Signals", lead=f"No signals: {error}.")
    return Section(name="signals", title="Signals", lead=lead, figures=[figure])


def _again(analysis: Analysis, worst: Evaluation, name: str) -> Figure:
    default = replace(worst, parameters=analysis.defaults)
    of_default, of_trial = simulate(analysis.study, [default, worst])
    sides = {DEFAULT: of_default, name: of_trial}
    drawn = panels({"": sides}, side_styles(name), analysis.study)
    return _figure(drawn, "Drag across a panel to zoom in; double-click to zoom out.")


def _figure(drawn: Sequence[Panel], caption: str) -> Figure:
    return Figure(
        name="signals",
        title="What does it do in the worst of its test runs?",
        caption=caption,
        alternative=f"{counted(len(drawn), 'signal')} over time.",
        panels=drawn,
        panel_height=260,
    )
