"""Failed test runs (evaluations), outliers of the objective, and gaps in signals."""

from collections.abc import Sequence

from bo_tuner.report.analysis import Analysis
from bo_tuner.report.content import Section, Table, number
from bo_tuner.storage.guard_record import read_acts
from bo_tuner.storage.run_files import BAGS, LOGS, bag_name
from bo_tuner.study.titles import mean_title
from bo_tuner.text import values, with_unit
from bo_tuner.trials import Evaluation, Trial

MOST_NOTES = 10
"""Evaluations with gaps in signals that are listed one by one."""


def failures(analysis: Analysis) -> Section:
    """List failures and outliers."""
    failed = [
        r
        for r in analysis.record.evaluations
        if not r.outcome.complete and not r.outcome.was_cut_short
    ]
    outliers = [t for t in analysis.trials if t.number in analysis.models.outliers]
    tables = []
    if failed:
        tables.append(_failed_table(analysis, failed))
    if outliers:
        tables.append(_outlier_table(analysis, outliers))
    warnings = [f"Trial {t.number}: {text}." for t in analysis.trials for text in t.warnings]
    lead = f"Failed test runs: {len(failed)}. Trials far off all others: {len(outliers)}."
    return Section(
        name="failures",
        title="What failed?",
        lead=lead
        if failed or outliers
        else "No test run failed, and no trial is far off all others.",
        tables=tables,
        notes=[
            *warnings,
            *_gaps(analysis.record.evaluations),
            *(f"{act}." for act in read_acts(analysis.record.path / LOGS)),
        ],
    )


def _gaps(evaluations: Sequence[Evaluation]) -> list[str]:
    """Name the evaluations with gaps in their signals, and the gaps of the first few."""
    marked = [e for e in evaluations if e.outcome.complete and e.outcome.notes.remark]
    notes = [f"Gaps in signals, {e.place}: {e.outcome.notes.remark}." for e in marked[:MOST_NOTES]]
    if rest := len(marked) - len(notes):
        notes.append(f"{rest} more have gaps: column notes.remark of evaluations.csv.")
    return notes


def _failed_table(analysis: Analysis, failed: Sequence[Evaluation]) -> Table:
    return Table(
        caption="Failed test runs, in the order in which they ran",
        header=["trial", "stage", "state", "reason", "parameters", "context", "seed", "bag"],
        rows=[
            [
                str(r.whose),
                r.stage,
                r.outcome.ending,
                r.outcome.reason,
                analysis.tuned_in_words(r.parameters),
                values(r.context),
                str(r.seed),
                _bag(analysis, r),
            ]
            for r in failed
        ],
    )


def _outlier_table(analysis: Analysis, outliers: Sequence[Trial]) -> Table:
    metric = analysis.study.metrics[analysis.study.objective.metric]
    return Table(
        caption="Far off: trials left out of the models; their vicinity is avoided",
        header=["trial", "parameters", with_unit(mean_title(metric.title), metric.unit)],
        rows=[
            [
                str(trial.number),
                analysis.tuned_in_words(trial.parameters),
                number(trial.mean(metric.name)),
            ]
            for trial in outliers
        ],
        numeric=[2],
    )


def _bag(analysis: Analysis, evaluation: Evaluation) -> str:
    """Return the path of its bag within the run folder; a dash if it was not kept."""
    path = f"{BAGS}/{bag_name(evaluation)}"
    return path if (analysis.record.path / path).is_dir() else "–"
