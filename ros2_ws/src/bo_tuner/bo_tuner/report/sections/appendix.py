"""The tables at the end of the report: all trials, and the provenance of the run."""

import numpy as np

from bo_tuner.deploy.bundle import DEPLOY, PROVENANCE
from bo_tuner.report.analysis import Analysis
from bo_tuner.report.content import Section, Table, method_in_words, number
from bo_tuner.study.titles import mean_title
from bo_tuner.text import counted, with_unit

RESULT, NEIGHBOUR = "result", "neighbour"
SHOWN = ("study_sha256", "started", "host", "platform", "python", "commit")
"""Of the provenance, what stands in the report."""
NEIGHBOURS = 3
"""So many trials next to the result are marked."""


def all_trials(analysis: Analysis) -> Section:
    """List all trials, with marks on the result and on the trials next to it."""
    study = analysis.study
    names = study.tuned_names
    metrics = [study.metrics[objective.metric] for objective in study.objectives]
    worst = study.worst_case_constraints
    header = [
        "trial",
        *(with_unit(study.parameters[n].title, study.parameters[n].unit) for n in names),
    ]
    header += [with_unit(mean_title(metric.title), metric.unit) for metric in metrics]
    header += [with_unit(f"worst {study.limited(c)}", study.metrics[c.metric].unit) for c in worst]
    header += ["test runs", "outcome", "mark"]
    marks = _marks(analysis)
    rows = []
    for trial in analysis.trials:
        parameters = study.on_screen(trial.parameters)
        row = [str(trial.number), *(number(parameters[n]) for n in names)]
        row += [number(analysis.estimate(trial, metric.name).value) for metric in metrics]
        worst_cases = [trial.worst_cases.get(constraint.name) for constraint in worst]
        row += [number(None if item is None else item.value) for item in worst_cases]
        row += [str(len(trial.evaluations)), analysis.outcome(trial), marks.get(trial.number, "")]
        rows.append(row)
    return Section(
        name="all-trials",
        title="All trials",
        lead=f"Marked are the result and the {NEIGHBOURS} trials nearest to it; means are "
        f"{analysis.means_in_words}.",
        tables=[
            Table(
                caption=counted(len(rows), "trial"),
                header=header,
                rows=rows,
                numeric=[*range(len(header) - 2)],
                folded=True,
                sortable=True,
                marked=[k for k, row in enumerate(rows) if row[-1] == RESULT],
            )
        ],
    )


def _marks(analysis: Analysis) -> dict[int, str]:
    """Return the marks of trials by their number."""
    result = analysis.answer
    if result is None:
        return {}
    space = analysis.study.search_space()
    place = space.to_cube(result.parameters)
    others = [trial for trial in analysis.trials if trial.number != result.number]
    distances = [np.linalg.norm(space.to_cube(trial.parameters) - place) for trial in others]
    nearest = np.argsort(distances, kind="stable")[:NEIGHBOURS]
    return {others[k].number: NEIGHBOUR for k in nearest} | {result.number: RESULT}


def provenance(analysis: Analysis) -> Section:
    """Show what produced the run; study and versions are in files beside it."""
    record = analysis.record
    made_by = record.provenance
    rows = [[name, made_by[name]] for name in SHOWN if made_by.get(name)]
    return Section(
        name="provenance",
        title="What made this report?",
        lead=f"Method {method_in_words(record.algorithm)}, backend {record.backend}, "
        f"seed {record.study.seed}. All versions and digests are in {DEPLOY}/{PROVENANCE}, the "
        "study in study.yaml.",
        tables=[
            Table(
                caption="Sources and machine",
                header=["", "value"],
                rows=[["run folder", record.path.resolve().name], *rows],
            )
        ],
    )
