"""The tables at the end: every trial, and where the run comes from."""

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
    header += ["cuts", "outcome"]
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
        lead="The same is in trials.csv and evaluations.csv in the run folder.",
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
    """Tell what produced the run, and the study as run."""
    record = analysis.record
    rows = [["run folder", record.path.resolve().name], *map(list, record.provenance.items())]
    return Section(
        name="provenance",
        title="Where this comes from",
        lead=f"Algorithm {record.algorithm}, backend {record.backend}, seed {record.study.seed}.",
        tables=[
            Table(caption="Provenance", header=["what", "value"], rows=rows),
            Table(
                caption="The study as run",
                header=["study.yaml"],
                rows=[[study_to_yaml(record.study)]],
                folded=True,
            ),
        ],
    )


def _with_unit(name: str, unit: str) -> str:
    return f"{name} [{unit}]" if unit else name
