"""The results page of a campaign: Markdown with its figures beside it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from bo_tuner.figures.figure import Figure
from tuning_benchmark import figures, findings, tables
from tuning_benchmark.experiment import Case, Experiment
from tuning_benchmark.experiment_parts import RANDOM
from tuning_benchmark.field_figure import field_figure
from tuning_benchmark.fields import axes
from tuning_benchmark.summary import Record, RowSummary, summarise

FOLDER = "figures"

LEGEND = """\
How to read the tables. *Held in validation*: the run called its answer feasible, and 25 fresh
draws showed no violation. *Truly feasible*: the mean over noise keeps the limit in each context of
a grid over the whole box, and real cuts keep the chance constraints. *Validated objective* and
*validated - training* are over all answers; training is the mean of the answer's cuts in the
tuning. The *true objective* is over 600 drawn contexts. *Narrow*: one step of an integer
costs more than a fifth in objective or beyond the limit. In brackets: 95 % confidence intervals,
Clopper-Pearson for shares, Student's t for means. Differences between rows are taken between runs
with the same seed, which share their initial samples and their validation's draws. *Compatible*:
Fisher's exact test does not tell the paper's counts from ours (p at least 0.05), which is no proof
that they are equal. There is no verdict where the paper's own difference is below 0.005.
"""

REMARKS = "Remarks, written by hand for the published campaign:"

CHOICES = """\
What Algorithm IV's rule, the posterior mean of its surrogates without its checks, would choose
among the same trials, beside what each optimizer chose. It separates the search from the final
choice. Given are the truly feasible ones and their mean true objective:
"""


@dataclass(frozen=True)
class Section:
    """Part of the page.

    Attributes
    ----------
    title
        Its heading.
    text
        What stands below, in Markdown; the figures are linked in it.
    figures
        To be written beside the page.
    """

    title: str
    text: str
    figures: tuple[Figure, ...] = ()


def sections(
    experiment: Experiment, done: Mapping[str, Record], missing: Sequence[str] = ()
) -> list[Section]:
    """Lay out a campaign; `missing` tells what of it is not on record yet."""
    parts = []
    for case in experiment.cases.values():
        summaries = summaries_of(experiment, case, done)
        parts.append(_case(experiment, case, summaries, done))
        if case.points:
            text = _points(experiment, case, summaries, done)
            title = f"{case.title}: the best parametrizations and their neighbours"
            parts.append(Section(title, text))
        if case.surrogates is not None:
            parts.append(_fields(case, done))
    if experiment.calibration is not None and not done["calibration"]["failed"]:
        figure, text = figures.calibration(experiment, done["calibration"]["result"])
        parts.append(Section("The model of the computing time", _with(text, figure), (figure,)))
    if experiment.cost is not None:
        figure, text = figures.cost_scaling(experiment, done)
        text = f"{_with(text, figure)}\n\n{tables.cost_table(experiment, done)}"
        parts.append(Section("Cost of a run", text, (figure,)))
    parts.append(Section(f"Provenance of {experiment.name}", provenance(experiment, done, missing)))
    return parts


def summaries_of(
    experiment: Experiment, case: Case, done: Mapping[str, Record]
) -> list[RowSummary]:
    """Sum up the rows of a case."""
    optimum = experiment.optimum(case.study)
    return [summarise(case, row, done, optimum) for row in case.rows.values()]


def markdown(parts: Sequence[Section], title: str, introduction: str) -> str:
    """Text of the page."""
    text = [f"# {title}", introduction.strip(), LEGEND.strip()]
    for part in parts:
        text += [f"## {part.title}", part.text.strip()]
    return "\n\n".join(text) + "\n"


def numbers(experiment: Experiment, done: Mapping[str, Record]) -> str:
    """Only what is the same whenever the campaign is repeated: the tables of all cases."""
    text = []
    for case in experiment.cases.values():
        summaries = summaries_of(experiment, case, done)
        text += [case.title, tables.comparison_table(case, summaries)]
        text.append(tables.convergence_table(case, summaries))
        if case.points:
            text.append(tables.neighbourhood_table(experiment, case, summaries, done))
    return "\n\n".join(text)


def _case(
    experiment: Experiment,
    case: Case,
    summaries: Sequence[RowSummary],
    done: Mapping[str, Record],
) -> Section:
    study = case.study
    initial = case.initial_trials or study.budget.initial_trials
    text = [
        f"{case.runs} {'run' if case.runs == 1 else 'runs'} of each row on the study "
        f"`{study.name}`, with the same initial sample of {initial} for all rows of one run. "
        f"A run's trials end with the one that reaches {case.evaluations} "
        f"evaluations{_exceptions(case)}; algorithms that check their candidates before they "
        f"answer leave {case.reserved_evaluations} of them for that.",
        *_protocols(case),
        tables.comparison_table(case, summaries),
    ]
    ranked = tables.ranked_table(case, summaries)
    if ranked:
        text += [CHOICES.strip(), ranked]
    published = tables.published_table(summaries)
    if published:
        text += ["The paper's numbers beside ours:", published]
    said = findings.beside_the_paper(case, summaries) + findings.beside_others(case, summaries)
    if said:
        text.append("\n".join(f"- {sentence}" for sentence in said))
    if case.remarks:
        text += [REMARKS, case.remarks.strip()]
    figure = figures.convergence(case, summaries, experiment.optimum(study))
    text += [
        _with("Truly feasible solutions, and their mean objective, along the way:", figure),
        tables.convergence_table(case, summaries),
    ]
    failures = [f"- {s.row.name}: {reason}" for s in summaries for reason in s.failures]
    if failures:
        text += ["Runs that failed, counted as infeasible:", "\n".join(failures)]
    return Section(case.title, "\n\n".join(text), (figure,))


def _protocols(case: Case) -> list[str]:
    """Tell how trials are cut where rows differ in that."""
    rows = case.rows.values()
    if not any(row.optimizer for row in rows):
        return []
    worst = case.study.worst_case_constraint
    text = []
    contexts = sorted({row.contexts for row in rows if row.protocol == RANDOM})
    if contexts:
        text.append(
            f"*Random*: each trial is cut in {' or '.join(map(str, contexts))} contexts drawn "
            f"anew, and its worst case is the largest {worst.name if worst else 'value'} seen."
        )
    if any(row.protocol != RANDOM and row.optimizer for row in rows):
        text.append(
            "*Worst case*: the trial is cut as one of Algorithm IV's, in drawn contexts and then "
            "by our search of the worst context."
        )
    return [" ".join(text)]


def _points(
    experiment: Experiment,
    case: Case,
    summaries: Sequence[RowSummary],
    done: Mapping[str, Record],
) -> str:
    """Lay out the parametrizations judged, and what the paper says of them."""
    table = tables.neighbourhood_table(experiment, case, summaries, done)
    said = "\n".join(f"- {sentence}" for sentence in findings.about_points(case, done))
    return f"{table}\n\n{said}".strip()


def _exceptions(case: Case) -> str:
    other = [
        f"{row.evaluations} for {row.name}"
        for row in case.rows.values()
        if row.evaluations is not None
    ]
    return f" ({', '.join(other)})" if other else ""


def _fields(case: Case, done: Mapping[str, Record]) -> Section:
    title = f"{case.title}: final surrogates and the truth"
    figure_of = case.surrogates
    points = 0 if figure_of is None else figure_of.points
    columns = [done[f"truth/{case.name}/{first}"] for first in axes(case.study, points)[0]]
    record = done[f"surrogates/{case.name}"]
    failed = [r["failed"] for r in (record, *columns) if r["failed"]]
    if failed:
        return Section(title, f"No figure: {failed[0]}")
    figure = field_figure(case, record["result"], [c["result"] for c in columns])
    return Section(title, _with("", figure), (figure,))


def _with(text: str, figure: Figure) -> str:
    """Put a figure below a text."""
    link = f"![{figure.title}]({FOLDER}/{figure.name}.png)"
    return f"{text}\n\n{link}\n\n*{figure.caption}*".strip()


def provenance(
    experiment: Experiment, done: Mapping[str, Record], missing: Sequence[str] = ()
) -> str:
    """Tell commits, machines, seeds, and how fast it went."""
    lines = []
    results = [r["result"] for name, r in done.items() if name.startswith("run/") and r["result"]]
    evaluations = sum(result["cuts"] for result in results)
    in_evaluations = sum(result["seconds"]["cuts"] for result in results)
    optimizer = sum(result["seconds"]["optimizer"] for result in results)
    wall = sum(record["wall_seconds"] for record in done.values())
    seeds = {case.name: case.runs for case in experiment.cases.values()}
    if in_evaluations > 0.0:
        lines.append(
            f"- {len(results)} runs with {evaluations} evaluations of the trials: "
            f"{evaluations / in_evaluations:.0f} evaluations per second and core; the optimizers "
            f"took {optimizer / (optimizer + in_evaluations):.0%} of the runs' processor time. "
            f"All tasks together: {wall / 60.0:.1f} minutes on one core, with judging."
        )
    for name in experiment.cases:
        runs = [r for task, r in done.items() if task.startswith(f"run/{name}/")]
        if runs:
            lines.append(f"- {_duration(name, runs)}")
    lines.append(f"- Seeds: {', '.join(f'{name} 1 to {n}' for name, n in seeds.items())}.")
    for key, words in (("commit", "Commit"), ("machine", "Machine")):
        values = sorted({str(record["about"][key]) for record in done.values()})
        lines.append(f"- {words}: {'; '.join(values)}.")
    versions = {v for record in done.values() for v in record["about"]["versions"].split(", ")}
    lines.append(f"- Versions: {', '.join(sorted(versions, key=str.lower))}.")
    dates = sorted(record["about"]["date"] for record in done.values())
    lines.append(f"- Recorded from {dates[0]} to {dates[-1]}.")
    if missing:
        lines.append(f"- **Not on record yet**: {', '.join(missing)}.")
    return "\n".join(lines)


def _duration(name: str, runs: Sequence[Record]) -> str:
    """Tell how long the runs of a case took, whatever the number of processes."""
    walls = [run["wall_seconds"] for run in runs]
    return (
        f"{name}: {len(runs)} {'run' if len(runs) == 1 else 'runs'} took "
        f"{sum(walls) / 60.0:.1f} minutes, summed over the processes, with cuts, checks and "
        f"judging; the longest {max(walls):.0f} s."
    )


def failed_tasks(done: Mapping[str, Record]) -> dict[str, Any]:
    """Reasons of the tasks that failed, by task."""
    return {name: record["failed"] for name, record in done.items() if record["failed"]}
