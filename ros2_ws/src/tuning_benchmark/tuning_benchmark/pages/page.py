"""The results page of a campaign: Markdown with its figures beside it.

One table for each question; what else is known of a case is in `numbers`.
"""

from collections.abc import Iterable, Mapping, Sequence
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
    cost_task,
    point_task,
    run_task,
    surrogates_task,
    truth_task,
)
from tuning_benchmark.pages import figures, findings, tables
from tuning_benchmark.pages.field_figure import field_figure
from tuning_benchmark.pages.summary import Record, RowSummary, summarize

FOLDER, FORMAT = "figures", "svg"
COMMIT_DIGITS = 10

LEGEND = """\
*Truly feasible*: in each context of a grid over the whole box the limit is kept by the mean over
noise, or by a single run with the limit's probability where the case has one, and evaluations on
the real objects satisfy the chance constraints. *Held*: the run called its answer feasible, and 25
fresh test runs showed no violation. *Objective*: true mean over 600 drawn contexts, of the truly
feasible answers. *Regret at equal margin*: their distance to the lowest objective of any parameter
set whose worst case is as large. *Within the limit*: share of runs in the answer's worst context,
mean and lowest over all answers. *Near*: runs whose incumbent was truly feasible and within 5 % of
the optimum for good, and the median of the evaluations until then. *Evaluations*: mean of the
trials + checks. In brackets: 95 % confidence intervals, Clopper-Pearson for shares, Student's t for
means. `benchmark` prints further tables.
"""


@dataclass(frozen=True)
class Campaign:
    """An experiment with what is on record of it.

    Attributes
    ----------
    experiment
        As far as it is on record.
    done
        Its records by task.
    missing
        What is not on record yet, in words.
    argument
        How the option ``--experiment`` names it.
    records
        Path of the file of its records, relative to the page.
    """

    experiment: Experiment
    done: Mapping[str, Record]
    missing: Sequence[str] = ()
    argument: str = ""
    records: str = ""


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
    """

    title: str
    text: str
    figures: tuple[Figure, ...] = ()


def sections(campaign: Campaign) -> list[Section]:
    """Lay out a campaign: a section for each question, with its origin at the end."""
    experiment, done = campaign.experiment, campaign.done
    parts = []
    others = []
    for case in experiment.cases.values():
        summaries = summaries_of(experiment, case, done)
        if not any(row.published for row in case.rows.values()):
            others.append((case, summaries))
            continue
        parts.append(_case(campaign, case, summaries))
        if case.points:
            parts.append(_points(campaign, case))
        if case.surrogates is not None:
            parts.append(_fields(campaign, case, case.surrogates))
    if others:
        parts.append(_cases(campaign, others))
    if experiment.calibration is not None and not done[CALIBRATION]["failed"]:
        figure, text = figures.calibration(experiment.calibration, done[CALIBRATION]["result"])
        text = _with(text, figure) if figure else text
        text = f"{text}\n\n{_origin(campaign, [done[CALIBRATION]])}"
        parts.append(Section("The model of the computing time", text, (figure,) if figure else ()))
    if experiment.cost is not None:
        cost = experiment.cost
        figure, text = figures.cost_scaling(cost, done)
        seeds = range(1, cost.seeds + 1)
        measured = [done[cost_task(d, seed)] for d in cost.dimensions for seed in seeds]
        text = "\n\n".join(
            [
                _with(text, figure),
                tables.cost_table(cost, done),
                _origin(campaign, measured, cost.seeds),
            ]
        )
        parts.append(Section("Cost of a run", text, (figure,)))
    return parts


def summaries_of(
    experiment: Experiment, case: Case, done: Mapping[str, Record]
) -> list[RowSummary]:
    """Sum up the rows of a case."""
    optimum = experiment.optimum(case.study)
    return [summarize(case, row, done, optimum) for row in case.rows.values()]


def markdown(
    parts: Sequence[Section], campaigns: Sequence[Campaign], title: str, introduction: str
) -> str:
    """Text of the page."""
    text = [f"# {title}", introduction.strip(), LEGEND.strip()]
    for part in parts:
        text += [f"## {part.title}", part.text.strip()]
    text.append("## Provenance")
    for campaign in campaigns:
        text += [f"Experiment `{campaign.experiment.name}`:", provenance(campaign)]
    return "\n\n".join(text) + "\n"


def numbers(experiment: Experiment, done: Mapping[str, Record]) -> str:
    """All tables of all cases, without measured times: the same if the campaign is repeated."""
    text = []
    for case in experiment.cases.values():
        summaries = summaries_of(experiment, case, done)
        sentences = findings.beside_the_paper(case, summaries) + findings.beside_others(
            case, summaries
        )
        text += [
            case.title,
            tables.comparison_table(case, summaries),
            tables.published_table(summaries),
            tables.fair_table(case, summaries),
            tables.paired_table(case, summaries),
            tables.ranked_table(case, summaries),
            tables.convergence_table(case, summaries),
            "\n".join(f"- {sentence}" for sentence in sentences),
        ]
        if case.points:
            text.append(tables.neighbourhood_table(case, summaries, done))
    return "\n\n".join(part for part in text if part)


def _case(campaign: Campaign, case: Case, summaries: Sequence[RowSummary]) -> Section:
    study, optimum = case.study, campaign.experiment.optimum(case.study)
    initial = case.initial_trials or study.budget.initial_trials
    text = [
        findings.in_brief(case, summaries),
        f"{case.runs} {'run' if case.runs == 1 else 'runs'} of each row on the study "
        f"`{study.name}`, from {initial} initial samples. A run ends with the trial that reaches "
        f"{case.evaluations} evaluations{_exceptions(case)}; {_kept(case)}.",
        tables.overview_table(case, summaries),
    ]
    if case.remarks:
        text.append(case.remarks.strip())
    drawn: tuple[Figure, ...] = ()
    # A single row is compared with nothing, and more than these cannot be kept apart.
    if 1 < len(summaries) <= len(figures.COLORS):
        drawn = (
            figures.convergence(case, summaries, None if optimum is None else optimum.objective),
        )
        text.append(_with("", *drawn))
    text.append(_origin(campaign, _runs(case, campaign.done), case.runs))
    return Section(case.title, "\n\n".join(text), drawn)


def _cases(campaign: Campaign, cases: Sequence[tuple[Case, Sequence[RowSummary]]]) -> Section:
    """Lay out cases that the paper does not have in one table."""
    text = [_protocols([case for case, _ in cases]), tables.cases_table(cases)]
    text += [case.remarks.strip() for case, _ in cases]
    runs = [record for case, _ in cases for record in _runs(case, campaign.done)]
    text.append(_origin(campaign, runs, max(case.runs for case, _ in cases)))
    return Section(
        campaign.experiment.title or campaign.experiment.name,
        "\n\n".join(part for part in dict.fromkeys(text) if part),
    )


def _origin(campaign: Campaign, records: Iterable[Record], seeds: int = 0) -> str:
    """Say where figures come from: command, commit, seeds, machine and days, and their records."""
    abouts = [record["about"] for record in records]
    commits, machines = ({str(about[key]) for about in abouts} for key in ("commit", "machine"))
    days = sorted({about["date"][:10] for about in abouts})
    parts = [
        f"`benchmark --experiment {campaign.argument}`",
        f"commit {', '.join(sorted(commit[:COMMIT_DIGITS] for commit in commits))}",
        *([f"seeds 1 to {seeds}"] if seeds > 1 else ["seed 1"] if seeds else []),
        "; ".join(sorted(machines)),
        " to ".join(dict.fromkeys((days[0], days[-1]))),
        f"[records]({campaign.records})",
    ]
    return f"*{', '.join(parts)}.*"


def _protocols(cases: Sequence[Case]) -> str:
    """Explain how trials are evaluated, where rows differ in that."""
    rows = [row for case in cases for row in case.rows.values()]
    worst = next((w for case in cases for w in case.study.worst_case_constraints), None)
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
    return " ".join(text)


def _points(campaign: Campaign, case: Case) -> Section:
    """Lay out the parameter sets that the experiment asks for, compared with the paper."""
    done = campaign.done
    judged = [done[point_task(case.name, name)] for name in case.points]
    sentences = "\n".join(f"- {sentence}" for sentence in findings.about_points(case, done))
    table = tables.neighbourhood_table(case, (), done, neighbours=False)
    parts = [part for part in (table, sentences, _origin(campaign, judged)) if part]
    return Section(f"{case.title}: single parameter sets", "\n\n".join(parts))


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


def _fields(campaign: Campaign, case: Case, figure: SurrogateFigure) -> Section:
    done = campaign.done
    title = f"{case.title}: final surrogates and the truth"
    columns = [done[truth_task(case.name, first)] for first in figure.axes(case.study)[0]]
    record = done[surrogates_task(case.name)]
    failed = [r["failed"] for r in (record, *columns) if r["failed"]]
    if failed:
        return Section(title, f"No figure: {failed[0]}")
    drawn = field_figure(case, figure, record["result"], [c["result"] for c in columns])
    origin = _origin(campaign, [record, *columns])
    return Section(title, f"{_with('', drawn)}\n\n{origin}", (drawn,))


def _with(text: str, figure: Figure) -> str:
    """Put a figure below a text."""
    link = f"![{figure.title}]({FOLDER}/{figure.name}.{FORMAT})"
    return f"{text}\n\n{link}\n\n*{figure.caption}*".strip()


def provenance(campaign: Campaign) -> str:
    """List durations and versions of a campaign, what is missing and what failed."""
    experiment, done = campaign.experiment, campaign.done
    lines = []
    runs = {name: _runs(case, done) for name, case in experiment.cases.items()}
    results = [r["result"] for records in runs.values() for r in records if r["result"]]
    evaluations = sum(result["cuts"] for result in results)
    in_evaluations = sum(result["seconds"]["cuts"] for result in results)
    optimizer = sum(result["seconds"]["optimizer"] for result in results)
    wall = sum(record["wall_seconds"] for record in done.values())
    if in_evaluations > 0.0:
        lines.append(
            f"- {len(results)} runs with {evaluations} evaluations of the trials: "
            f"{evaluations / in_evaluations:.0f} evaluations per second and core; the optimizers "
            f"took {optimizer / (optimizer + in_evaluations):.0%} of the runs' processor time. "
            f"All tasks: {wall / 60.0:.1f} minutes on one core, with judging."
        )
    versions = {v for record in done.values() for v in record["about"]["versions"].split(", ")}
    lines.append(f"- Versions: {', '.join(sorted(versions, key=str.lower))}.")
    if campaign.missing:
        lines.append(f"- **Not on record yet**: {', '.join(campaign.missing)}.")
    failed = {name: record["failed"] for name, record in done.items() if record["failed"]}
    if failed:
        lines.append("- **Failed tasks**; a run that failed counts as infeasible:")
        lines += [f"  - {name}: {reason}" for name, reason in failed.items()]
    return "\n".join(lines)


def _runs(case: Case, done: Mapping[str, Record]) -> list[Record]:
    """Collect the records of the runs of a case."""
    seeds = range(1, case.runs + 1)
    return [done[run_task(case.name, row, seed)] for row in case.rows for seed in seeds]
