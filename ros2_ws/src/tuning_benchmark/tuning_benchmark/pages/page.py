"""The results page of a campaign: Markdown with its figures beside it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from bo_tuner.figures.figure import Figure
from bo_tuner.methods.registry import METHODS
from tuning_benchmark.campaign.division import reserve_in_words
from tuning_benchmark.experiments.experiment import (
    RANDOM,
    WORST_CASE,
    Case,
    Experiment,
    SurrogateFigure,
)
from tuning_benchmark.experiments.task_names import (
    CALIBRATION,
    run_task,
    surrogates_task,
    truth_task,
)
from tuning_benchmark.pages import figures, findings, tables
from tuning_benchmark.pages.field_figure import field_figure
from tuning_benchmark.pages.summary import Record, RowSummary, summarize

FOLDER = "figures"

LEGEND = """\
How to read the tables. *Held in validation*: the run called its answer feasible, and 25 fresh
draws showed no violation. *Truly feasible*: in each context of a grid over the whole box the limit
is kept by the mean over noise, or by a single run with the limit's probability where the case has
one and its remarks do not say otherwise, and evaluations on the real objects satisfy the chance
constraints.
*Validated objective* and *validated - training* are over all answers; training is the mean of the
answer's evaluations during tuning. The *true objective* is the mean over 600 drawn contexts.
*Narrow*: one step of an integer worsens the objective, or exceeds the limit, by more than a fifth.
In brackets: 95 % confidence intervals, Clopper-Pearson for shares, Student's t for means.
Differences between rows are taken between runs with the same seed, which share their initial
samples and their validation draws. *Compatible*: Fisher's exact test finds no difference between
the paper's counts and ours (p at least 0.05), which does not prove them equal. Differences below
0.005 in the paper are not judged.
"""

REMARKS = "Remarks on the published campaign, written by hand:"

CHOICES = """\
The choice of Algorithm IV's rule (the posterior mean of its surrogates, without its checks) among
the same trials, beside the choice of each optimizer. This separates the search from the final
choice. The table counts the truly feasible choices and gives their mean true objective:
"""


FAIR = """\
Against what is known of the optimum. *Regret at equal margin*: distance of the truly feasible
answers to the lowest objective of any parameter set whose worst case is as large as the answer's
own, so that an answer is not blamed for its margin; it needs the frontier of the problem. That of
a grid is known between few points, and an answer may lie below it.
*Realized probability*: share of runs within the limit in the answer's worst context, mean and
lowest over all answers. *Near*: evaluations until the incumbent was truly feasible and within 5 %
of the optimum for good; the median counts a run that never was as longer than any other.
"""

PAIRED = """\
Compared pairwise, by seed, with the first row: the runs in which only one of both has a truly
feasible answer, with the exact test of McNemar (1947), and the differences where both have one,
first mean and interval of the true objective, then of the regret at equal margin:
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
        Files beside the page.
    brief
        What was found, in a line for the head of the page; empty if nothing was.
    """

    title: str
    text: str
    figures: tuple[Figure, ...] = ()
    brief: str = ""


def sections(
    experiment: Experiment, done: Mapping[str, Record], missing: Sequence[str] = ()
) -> list[Section]:
    """Lay out a campaign; `missing` lists what is not on record yet."""
    parts = []
    for case in experiment.cases.values():
        summaries = summaries_of(experiment, case, done)
        parts.append(_case(experiment, case, summaries, done))
        if case.points:
            text = _points(case, summaries, done)
            title = f"{case.title}: the best parameter sets and their neighbours"
            parts.append(Section(title, text))
        if case.surrogates is not None:
            parts.append(_fields(case, case.surrogates, done))
    if experiment.calibration is not None and not done[CALIBRATION]["failed"]:
        figure, text = figures.calibration(experiment.calibration, done[CALIBRATION]["result"])
        parts.append(
            Section(
                "The model of the computing time",
                _with(text, figure) if figure else text,
                (figure,) if figure else (),
            )
        )
    if experiment.cost is not None:
        figure, text = figures.cost_scaling(experiment.cost, done)
        text = f"{_with(text, figure)}\n\n{tables.cost_table(experiment.cost, done)}"
        parts.append(Section("Cost of a run", text, (figure,)))
    parts.append(Section(f"Provenance of {experiment.name}", provenance(experiment, done, missing)))
    return parts


def summaries_of(
    experiment: Experiment, case: Case, done: Mapping[str, Record]
) -> list[RowSummary]:
    """Sum up the rows of a case."""
    optimum = experiment.optimum(case.study)
    return [summarize(case, row, done, optimum) for row in case.rows.values()]


def markdown(parts: Sequence[Section], title: str, introduction: str) -> str:
    """Text of the page."""
    brief = [f"- {part.brief}" for part in parts if part.brief]
    text = [f"# {title}"]
    if brief:
        text += ["What was found, case by case:", "\n".join(brief)]
    text += [introduction.strip(), LEGEND.strip()]
    for part in parts:
        text += [f"## {part.title}", part.text.strip()]
    return "\n\n".join(text) + "\n"


def numbers(experiment: Experiment, done: Mapping[str, Record]) -> str:
    """Tables of all cases, without measured times: the same whenever the campaign is repeated."""
    text = []
    for case in experiment.cases.values():
        summaries = summaries_of(experiment, case, done)
        text += [case.title, tables.comparison_table(case, summaries)]
        text.append(tables.convergence_table(case, summaries))
        if case.points:
            text.append(tables.neighbourhood_table(case, summaries, done))
    return "\n\n".join(text)


def _case(
    experiment: Experiment,
    case: Case,
    summaries: Sequence[RowSummary],
    done: Mapping[str, Record],
) -> Section:
    study, optimum = case.study, experiment.optimum(case.study)
    initial = case.initial_trials or study.budget.initial_trials
    text = [
        f"{case.runs} {'run' if case.runs == 1 else 'runs'} of each row on the study "
        f"`{study.name}`; runs with the same seed share their {initial} initial samples. A run "
        f"ends with the trial that reaches {case.evaluations} evaluations{_exceptions(case)}; "
        f"{_kept(case)}.",
        *_protocols(case),
        tables.comparison_table(case, summaries),
    ]
    ranked = tables.ranked_table(case, summaries)
    if ranked:
        text += [CHOICES.strip(), ranked]
    published = tables.published_table(summaries)
    if published:
        text += ["The paper's numbers beside ours:", published]
    fair = tables.fair_table(case, summaries)
    paired = tables.paired_table(case, summaries)
    text += [FAIR.strip(), fair] if fair else []
    text += [PAIRED.strip(), paired] if paired else []
    said = findings.beside_the_paper(case, summaries) + findings.beside_others(case, summaries)
    if said:
        text.append("\n".join(f"- {sentence}" for sentence in said))
    if case.remarks:
        text += [REMARKS, case.remarks.strip()]
    figure = figures.convergence(case, summaries, None if optimum is None else optimum.objective)
    text += [
        _with("Truly feasible incumbents during the runs, and their objective:", figure),
        tables.convergence_table(case, summaries),
    ]
    brief = findings.in_brief(case, summaries)
    return Section(case.title, "\n\n".join(text), (figure,), brief)


def _protocols(case: Case) -> list[str]:
    """Explain how trials are evaluated, where rows differ in that."""
    rows = case.rows.values()
    if not any(row.optimizer for row in rows):
        return []
    worst = next(iter(case.study.worst_case_constraints), None)
    text = []
    contexts = sorted({row.contexts for row in rows if row.protocol == RANDOM})
    if contexts:
        text.append(
            f"*Random*: each trial is evaluated in {' or '.join(map(str, contexts))} newly drawn "
            f"contexts; its worst case is the largest {worst.name if worst else 'value'} observed."
        )
    if any(row.protocol == WORST_CASE and row.optimizer for row in rows):
        text.append(
            "*Worst case*: the trial is evaluated as in Algorithm IV, in drawn contexts and then "
            "by our search for the worst context."
        )
    return [" ".join(text)]


def _points(case: Case, summaries: Sequence[RowSummary], done: Mapping[str, Record]) -> str:
    """Lay out the judged parameter sets, compared with the paper."""
    table = tables.neighbourhood_table(case, summaries, done)
    said = "\n".join(f"- {sentence}" for sentence in findings.about_points(case, done))
    return f"{table}\n\n{said}".strip()


def _kept(case: Case) -> str:
    """Tell which evaluations are not those of trials."""
    algorithms = {row.algorithm for row in case.rows.values() if row.algorithm}
    # As often as methods keep the same, it is said once.
    reserved = case.reserved_evaluations
    kept = {reserve_in_words(METHODS[name], reserved): None for name in sorted(algorithms)}
    return "; ".join(kept) or "no row checks its candidates"


def _exceptions(case: Case) -> str:
    other = [
        f"{row.evaluations} for {row.name}"
        for row in case.rows.values()
        if row.evaluations is not None
    ]
    return f" ({', '.join(other)})" if other else ""


def _fields(case: Case, figure: SurrogateFigure, done: Mapping[str, Record]) -> Section:
    title = f"{case.title}: final surrogates and the truth"
    columns = [done[truth_task(case.name, first)] for first in figure.axes(case.study)[0]]
    record = done[surrogates_task(case.name)]
    failed = [r["failed"] for r in (record, *columns) if r["failed"]]
    if failed:
        return Section(title, f"No figure: {failed[0]}")
    drawn = field_figure(case, figure, record["result"], [c["result"] for c in columns])
    return Section(title, _with("", drawn), (drawn,))


def _with(text: str, figure: Figure) -> str:
    """Put a figure below a text."""
    link = f"![{figure.title}]({FOLDER}/{figure.name}.png)"
    return f"{text}\n\n{link}\n\n*{figure.caption}*".strip()


def provenance(
    experiment: Experiment, done: Mapping[str, Record], missing: Sequence[str] = ()
) -> str:
    """List commits, machines, seeds and durations, what is missing and what failed."""
    lines = []
    runs = {name: _runs(case, done) for name, case in experiment.cases.items()}
    results = [r["result"] for records in runs.values() for r in records if r["result"]]
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
            f"All tasks: {wall / 60.0:.1f} minutes on one core, with judging."
        )
    lines += [f"- {_duration(name, records)}" for name, records in runs.items()]
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
    failed = {name: record["failed"] for name, record in done.items() if record["failed"]}
    if failed:
        lines.append("- **Failed tasks**; a run that failed counts as infeasible:")
        lines += [f"  - {name}: {reason}" for name, reason in failed.items()]
    return "\n".join(lines)


def _runs(case: Case, done: Mapping[str, Record]) -> list[Record]:
    """Collect the records of the runs of a case."""
    seeds = range(1, case.runs + 1)
    return [done[run_task(case.name, row, seed)] for row in case.rows for seed in seeds]


def _duration(name: str, runs: Sequence[Record]) -> str:
    """Sum up how long the runs of a case took, independent of the number of processes."""
    walls = [run["wall_seconds"] for run in runs]
    return (
        f"{name}: {len(runs)} {'run' if len(runs) == 1 else 'runs'} took "
        f"{sum(walls) / 60.0:.1f} minutes, summed over the processes, with evaluations, checks "
        f"and judging; the longest {max(walls):.0f} s."
    )
