"""The tables at the end of the report: all trials, and the provenance of the run."""

from bo_tuner.report.analysis import Analysis
from bo_tuner.report.content import Section, Table, number
from bo_tuner.study.study_file import study_to_yaml


def all_trials(analysis: Analysis) -> Section:
    """List all trials."""
    study = analysis.study
    names = study.search_space().names
    metric = study.metrics[study.objective.metric]
    worst = study.worst_case_constraint
    header = ["trial", "origin", *(_with_unit(n, study.parameters[n].unit) for n in names)]
    header.append(_with_unit(f"mean {metric.name}", metric.unit))
    if worst is not None:
        header.append(_with_unit(f"worst {worst.metric}", study.metrics[worst.metric].unit))
    header += ["evaluations", "outcome"]
    rows = []
    for trial in analysis.trials:
        row = [str(trial.number), trial.origin, *(number(trial.parameters[n]) for n in names)]
        row.append(number(analysis.mean_objective(trial)))
        if worst is not None:
            row.append(number(trial.worst_case.value if trial.worst_case else None))
        rows.append([*row, str(len(trial.evaluations)), analysis.outcome(trial)])
    return Section(
        name="trials",
        title="All trials",
        lead="As a table for other programs: trials.csv and evaluations.csv in the run folder.",
        tables=[
            Table(
                caption=f"{len(rows)} trials",
                header=header,
                rows=rows,
                numeric=range(2, len(header) - 1),
                folded=True,
            )
        ],
    )


def provenance(analysis: Analysis) -> Section:
    """Show what produced the run, and its study."""
    record = analysis.record
    rows = [["run folder", record.path.resolve().name], *map(list, record.provenance.items())]
    return Section(
        name="provenance",
        title="Provenance",
        lead=f"Algorithm {record.algorithm}, backend {record.backend}, seed {record.study.seed}.",
        tables=[
            Table(caption="Versions, sources and machine", header=["", "value"], rows=rows),
            Table(
                caption="The study, with the options of the run",
                header=["study.yaml"],
                rows=[[study_to_yaml(record.study)]],
                folded=True,
            ),
        ],
    )


def _with_unit(name: str, unit: str) -> str:
    return f"{name} [{unit}]" if unit else name
