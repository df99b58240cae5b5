"""Several runs side by side: verdicts, parameters, numbers, convergence and trajectories."""

import math
from collections.abc import Mapping, Sequence
from itertools import cycle, islice

from bo_tuner.errors import BackendError, StudyError
from bo_tuner.evidence.quantity import Quantity
from bo_tuner.evidence.words.limits import in_words as limit_in_words
from bo_tuner.evidence.words.quantities import gain
from bo_tuner.evidence.words.verdict import basis, mark_in_words, page_title
from bo_tuner.figures.figure import Axis, Color, Dash, Figure, Line, Panel, Scale
from bo_tuner.numerics.seeds import Stream, noise_seed
from bo_tuner.report.analysis import Analysis
from bo_tuner.report.content import Section, Table, change, method_in_words, number
from bo_tuner.report.sections.convergence import incumbents
from bo_tuner.report.sections.trajectories import NoTraceError, Trace, panels, simulate
from bo_tuner.study.limits import tightest
from bo_tuner.study.titles import mean_title
from bo_tuner.text import with_unit
from bo_tuner.trials import Evaluation, Stage, Value, count_trials

DASHES = (Dash.SOLID, Dash.DASHED, Dash.DOTTED, Dash.DASH_DOT)
COLORS = (Color.INK, Color.BLUE, Color.ORANGE, Color.GREEN, Color.PURPLE)
LINES = tuple(islice(zip(cycle(DASHES), cycle(COLORS), strict=False), len(DASHES) * len(COLORS)))
"""Dash and colour of the lines of one run after the other.

Of the first eight, colours that look alike to some readers have different dashes.
"""

NOMINAL, WORST = "nominal context", "own worst context"
Row = tuple[str, str]
"""Name and unit: a run's value is not comparable with one in another unit."""
Cell = tuple[str, Value | None]
"""A run's value in words, and as it is."""
NO_VALUE: Cell = ("–", None)


def comparison(runs: Mapping[str, Analysis]) -> list[Section]:
    """Compare runs."""
    return [
        _verdicts(runs),
        _parameters(runs),
        _numbers(runs),
        _convergence(runs),
        _trajectories(runs),
    ]


def names(analyses: Sequence[Analysis]) -> list[str]:
    """Return the names of the runs' folders; their paths if two folders have the same name."""
    paths = [analysis.record.path.resolve() for analysis in analyses]
    unique = len({path.name for path in paths}) == len(paths)
    return [path.name if unique else str(path) for path in paths]


def verdicts_table(runs: Mapping[str, Analysis], caption: str) -> Table:
    """Return a table of runs, each with its verdict, in a row."""
    columns = ["state", "verdict", "trial", "evidence", "study", "how", "trials"]
    rows = []
    for name, analysis in runs.items():
        of_run = in_a_row(analysis)
        rows.append([name, *(of_run[column] for column in columns)])
    return Table(caption=caption, header=["run", *columns], rows=rows, numeric=[3, 7])


def in_a_row(analysis: Analysis) -> dict[str, str]:
    """Return what there is to say of a run in a row of a table, by the heading of its column."""
    record, verdict = analysis.record, analysis.verdict
    method = method_in_words(record.algorithm)
    gains = [
        f"{gain(q)}, {q.estimates[1].source}" if q.estimates else gain(q)
        for q in verdict.quantities
        if q.objective
    ]
    if verdict.infeasible is not None:
        # What a set that breaks a limit gains in the objective is no gain.
        gains = []
    return {
        "state": mark_in_words(verdict),
        "verdict": page_title(verdict),
        "objective": "; ".join(gains),
        "trial": "–" if verdict.trial is None else str(verdict.trial),
        "evidence": basis(verdict),
        "study": analysis.study.name,
        "how": f"{method}, {record.backend}, seed {record.study.seed}",
        "trials": f"{count_trials(record.trials)} of {analysis.study.budget.trials}",
    }


def _verdicts(runs: Mapping[str, Analysis]) -> Section:
    damaged = [f"{name}: {a.record.damage}" for name, a in runs.items() if a.record.damage]
    return Section(
        name="verdicts",
        title="Verdicts",
        lead="Each verdict is that of the run's own report, and rests on the run's own test runs.",
        tables=[verdicts_table(runs, "The results")],
        notes=[f"The record is damaged: {damage}." for damage in damaged],
    )


def _parameters(runs: Mapping[str, Analysis]) -> Section:
    return Section(
        name="parameters",
        title="Parameters",
        lead="The result of each run, or its best so far; the default is in brackets.",
        tables=[side_by_side("Parameter sets", {n: _parameter_set(a) for n, a in runs.items()})],
    )


def _parameter_set(analysis: Analysis) -> dict[Row, Cell]:
    result_parameters = {} if analysis.answer is None else analysis.answer.parameters
    return {
        (item.title_and_name, item.unit): (
            f"{number(result_parameters[name])} ({number(analysis.defaults[name])})",
            result_parameters[name],
        )
        for name, item in analysis.study.parameters.items()
        if name in result_parameters
    }


def _numbers(runs: Mapping[str, Analysis]) -> Section:
    cells = {
        name: {
            (quantity.label, quantity.unit): (_in_words(quantity), quantity.tuned)
            for quantity in analysis.verdict.quantities
        }
        for name, analysis in runs.items()
    }
    return Section(
        name="numbers",
        title="Numbers",
        lead="The tuned value of each run, and what its verdict says of it against the run's "
        "own default, which is in brackets.",
        tables=[side_by_side("Numbers of the verdicts", cells)],
        notes=[
            "Runs with different seeds, budgets or studies draw different contexts and noise, so "
            "part of the difference between two columns is chance. Only differences from the "
            "default are measured in the same contexts and noise.",
            *(["The difference is the second run minus the first."] if len(runs) == 2 else []),
        ],
    )


def _in_words(quantity: Quantity) -> str:
    default, tuned = quantity.values_in_words
    text = f"{tuned} ({default})"
    if quantity.limit_verdict is not None:
        text += f", limit {quantity.limit_in_words}: {limit_in_words(quantity.limit_verdict)}"
    if quantity.difference is not None:
        text += f", {quantity.change}"
    return text


def side_by_side(caption: str, cells: Mapping[str, Mapping[Row, Cell]]) -> Table:
    """Return a table with a column for each run, and a row for each name with its unit."""
    names = dict.fromkeys(row for of_run in cells.values() for row in of_run)
    rows = []
    for name in names:
        of_runs = [of_run.get(name, NO_VALUE) for of_run in cells.values()]
        texts = [text for text, _ in of_runs]
        rows.append([with_unit(*name), *texts, _difference([value for _, value in of_runs])])
    last = "difference" if len(cells) == 2 else "largest difference"
    return Table(caption=caption, header=["", *cells, last], rows=rows, numeric=[1 + len(cells)])


def _difference(values: Sequence[Value | None]) -> str:
    """Return how values of runs differ: of two the second minus the first, of more the range."""
    known = [value for value in values if value is not None]
    if len(known) < len(values):
        return "–"
    if all(value == known[0] for value in known):
        return "none"
    numbers = [v for v in known if isinstance(v, int | float) and not isinstance(v, bool)]
    if len(numbers) < len(known):
        return "differ"
    if len(numbers) > 2:
        return number(max(numbers) - min(numbers))
    first, second = numbers
    if not math.isfinite(second - first):
        return "–"
    share = f" ({change(second, first)})" if first > 0.0 else ""
    return f"{second - first:+.4g}{share}"


def _convergence(runs: Mapping[str, Analysis]) -> Section:
    panels: dict[tuple[str, str], list[Line]] = {}
    scales: dict[tuple[str, str], Scale] = {}
    titles: dict[str, str] = {}
    without = []
    for (name, analysis), (dash, color) in zip(runs.items(), cycle(LINES), strict=False):
        study = analysis.study
        objective = study.objective.metric, study.metrics[study.objective.metric].unit
        best_by_trial = incumbents(analysis)
        if not any(candidate.believed_feasible for _, candidate in best_by_trial):
            without.append(name)
            continue
        titles.setdefault(study.objective.metric, study.metrics[study.objective.metric].title)
        scales.setdefault(objective, Scale(study.objective.scale))
        panels.setdefault(objective, []).append(
            Line(
                x=[float(k) for k, _ in best_by_trial],
                y=[c.objective if c.believed_feasible else math.nan for _, c in best_by_trial],
                name=name,
                color=color,
                dash=dash,
                step=True,
                hover=[f"{name}: trial {c.trial.number}" for _, c in best_by_trial],
            )
        )
    return Section(
        name="convergence",
        title="Convergence",
        lead="How soon each run found what it found, by its own models.",
        figures=[_incumbents(panels, scales, titles)] if panels else [],
        notes=[f"{name}: no trial is likely within limits." for name in without],
    )


def _incumbents(
    panels: Mapping[tuple[str, str], list[Line]],
    scales: Mapping[tuple[str, str], Scale],
    titles: Mapping[str, str],
) -> Figure:
    """Draw the lines of a metric and unit in a panel, which has the title of the metric."""
    return Figure(
        name="comparison",
        title="The best so far of each run",
        caption="The parameter set that would be the result if the run ended there, by the "
        "mean that the run's own models predict; a line begins where one is likely within limits.",
        alternative="; ".join(
            f"{line.name}: {number(float(line.y[-1]))} at the end"
            for lines in panels.values()
            for line in lines
        ),
        panels=[
            Panel(
                x=Axis(label="trial"),
                y=Axis(label=mean_title(titles[metric]), unit=unit, scale=scales[metric, unit]),
                elements=lines,
            )
            for (metric, unit), lines in panels.items()
        ],
        columns=min(2, max(1, len(panels))),
    )


def _trajectories(runs: Mapping[str, Analysis]) -> Section:
    """Show the signals of each run's result, with the same noise."""
    columns: dict[str, dict[str, Trace]] = {NOMINAL: {}, WORST: {}}
    notes = []
    (first, *_) = runs.values()
    seed = noise_seed(first.study.seed, Stream.VALIDATION_NOISE, 0)
    for name, analysis in runs.items():
        if analysis.study.run is not None:
            notes.append(f"{name}: its signals are in its bags, and shown in its own report.")
            continue
        try:
            for column, trace in _traces(analysis, seed).items():
                columns[column][name] = trace
        except (NoTraceError, StudyError, BackendError) as error:
            notes.append(f"{name}: no trajectories: {error}.")
    columns = {title: sides for title, sides in columns.items() if sides}
    same = all(analysis.study.constraints == first.study.constraints for analysis in runs.values())
    common = first.study if same else None
    styles = {name: (color, dash) for name, (dash, color) in zip(runs, cycle(LINES), strict=False)}
    figures = []
    if columns:
        figures.append(
            Figure(
                name="trajectories",
                title="What does each do? One run of each result, with the same noise",
                caption="Simulated in process by each study's objects, not recorded. Drag across "
                "a panel to zoom in; double-click to zoom out.",
                alternative=f"Signals over time of {', '.join(columns[NOMINAL])}.",
                panels=panels(columns, styles, common),
                columns=len(columns),
                panel_height=260,
            )
        )
    return Section(
        name="trajectories",
        title="Trajectories",
        lead="The result of each run, or its best so far, in the nominal context of its study and "
        "in the worst one that the run found for it.",
        figures=figures,
        notes=notes,
    )


def _traces(analysis: Analysis, seed: int) -> dict[str, Trace]:
    """Return the signals of a run's result by the title of their column."""
    answer = analysis.answer
    if answer is None:
        raise NoTraceError("no trial is complete")
    space = analysis.study.context_space()
    contexts = {NOMINAL: space.to_dict(space.nominal())}
    if (worst := tightest(analysis.study, answer)) is not None:
        contexts[WORST] = dict(worst[1].context)
    planned = [
        Evaluation(0, 0, Stage.VALIDATION, answer.parameters, context, seed)
        for context in contexts.values()
    ]
    return dict(zip(contexts, simulate(analysis.study, planned), strict=True))
