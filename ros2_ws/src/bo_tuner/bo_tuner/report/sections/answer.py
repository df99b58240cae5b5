"""The first screen of a report: what is gained, what to set, each limit, and how it is shown."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from bo_tuner.deploy.bundle import DEPLOY
from bo_tuner.evidence.verdict import State, Status, Verdict
from bo_tuner.evidence.words.next_steps import Step, next_steps
from bo_tuner.evidence.words.quantities import details
from bo_tuner.evidence.words.verdict import (
    advice,
    bases,
    mark_in_words,
    of_default,
    page_title,
    reasons_and_remarks,
)
from bo_tuner.figures.figure import Figure
from bo_tuner.monitoring.progress import incumbent_in_words
from bo_tuner.report.analysis import Analysis
from bo_tuner.report.content import number
from bo_tuner.report.grid import POINTS, parameter_grid
from bo_tuner.report.sections.front import front_figure
from bo_tuner.report.sections.limit_rows import Row, rows
from bo_tuner.report.sections.trajectories import response
from bo_tuner.report.sections.trust import Trust, trust_lines
from bo_tuner.storage.parameter_file import node_values, sent_values, to_yaml
from bo_tuner.storage.run_files import BAGS
from bo_tuner.storage.run_folder import BEST, JOURNAL
from bo_tuner.study.function_study import FUNCTION
from bo_tuner.study.parameter import Parameter
from bo_tuner.text import capitalized, counted, with_unit
from bo_tuner.trials import count_trials

FILES = (
    (BEST, "the values as a parameter file"),
    (f"{DEPLOY}/", "deployment folder, with undo"),
    ("trials.csv", "all trials"),
    ("evaluations.csv", "all test runs"),
    (JOURNAL, "the record"),
    (f"{BAGS}/", "bags of notable trials"),
    ("certificates/", "certificates"),
)
DO_NOT_USE = "not within limits: do not use it"
"""What is said of a parameter file, and of values, where nothing was found feasible."""
NOT_TO_USE = (State.INFEASIBLE, State.REFUSED)
EVEN = 0.5
"""Probability of being within all limits below which a value is drawn as beyond them."""


@dataclass(frozen=True)
class Track:
    """A parameter on its range, from 0 at the lower bound to 1 at the upper one.

    Attributes
    ----------
    default, tuned
        Where the two values are.
    beyond
        Ends of the parts in which, by the models, the others as tuned, no set keeps the limits.
    """

    default: float
    tuned: float
    beyond: Sequence[tuple[float, float]]


@dataclass(frozen=True)
class Setting:
    """A parameter: its title, its values in words, what else to know, and where it is."""

    title: str
    default: str
    tuned: str
    note: str
    track: Track | None


@dataclass(frozen=True)
class Answer:
    """The content of the first screen of a report.

    Attributes
    ----------
    mark, status
        The verdict in a word or two, and how good that is.
    origin
        Of how many trials it is, of when, and where they were run.
    headline, below
        What is gained, and one sentence on the default.
    name
        What the parameter set is called beside the default.
    settings, fixed
        The tuned parameters, and those that were not tuned, in a line.
    file
        The values as a parameter file, to copy; empty if they are not to be used.
    rows
        Objectives, limits, and what else has changed.
    figure
        Default and result over time, or the front of several objectives.
    trust
        What speaks for the result, and what to be careful of.
    advice
        What blocks and what to do, where nothing was found feasible.
    remarks
        What else to know, in sentences.
    steps, compare
        Commands that come next, and the one that compares runs.
    certified
        Whether there is a certificate to look at.
    files
        Names of the files and folders of the run that exist, with their content.
    """

    mark: str
    status: Status
    origin: str
    headline: str
    below: str
    name: str
    settings: Sequence[Setting]
    fixed: str
    file: str
    rows: Sequence[Row]
    figure: Figure | None
    trust: Sequence[Trust]
    advice: Sequence[str]
    remarks: Sequence[str]
    steps: Sequence[Step]
    certified: bool
    compare: str
    files: Sequence[tuple[str, str]]


def answer(analysis: Analysis) -> Answer:
    """Return the answer of a run, or its state so far."""
    verdict, record, study = analysis.verdict, analysis.record, analysis.study
    result = analysis.answer
    parameters = {} if result is None else result.parameters
    usable = verdict.feasible and result is not None
    run = _run(analysis)
    return Answer(
        mark=mark_in_words(verdict),
        status=verdict.status,
        origin=_origin(analysis),
        headline=page_title(verdict),
        below=_below(analysis),
        name=analysis.answer_name,
        settings=[*_settings(analysis)],
        fixed=_fixed(analysis),
        file=to_yaml(node_values(study, parameters), sent_values(study, parameters))
        if usable
        else "",
        rows=[*rows(verdict)],
        figure=front_figure(analysis) or response(analysis),
        trust=trust_lines(analysis),
        advice=advice(verdict),
        remarks=[
            *reasons_and_remarks(verdict),
            *(f"{capitalized(line)}." for line in bases(verdict)),
            *([] if verdict.certificate else _details(verdict)),
        ],
        steps=steps(analysis),
        certified=analysis.certificate is not None or bool(analysis.certificate_problem),
        compare=f"report {run} OTHER_RUN" if run else "",
        files=[
            (name, DO_NOT_USE if name == BEST and verdict.state in NOT_TO_USE else what)
            for name, what in FILES
            if (record.path / name).exists()
        ],
    )


def steps(analysis: Analysis) -> tuple[Step, ...]:
    """Return the commands that come next."""
    run = _run(analysis)
    return next_steps(analysis.verdict, run) if run else ()


def _run(analysis: Analysis) -> str:
    """Return the folder of the run for commands; empty where they do not reach what was run."""
    record = analysis.record
    # The page may be opened from any folder.
    return "" if record.backend == FUNCTION else str(record.path.resolve())


def _origin(analysis: Analysis) -> str:
    """Return how many trials there are, when they began, and where they ran."""
    record = analysis.record
    made, planned = count_trials(record.trials), analysis.study.budget.trials
    trials = counted(planned, "trial")
    parts = [trials if made == planned else f"{made} of {trials}"]
    if began := record.provenance.get("started", "")[:16].replace("T", " "):
        parts.append(began)
    where = {"inprocess": "simulated in process", FUNCTION: "a function"}
    parts.append(where.get(record.backend, "on ROS nodes"))
    return " · ".join(parts)


def _below(analysis: Analysis) -> str:
    """Return what the same evidence says of the default; before a result, what is best so far."""
    verdict = analysis.verdict
    if verdict.quantities:
        return "" if verdict.is_default else of_default(verdict)
    return f"{capitalized(incumbent_in_words(analysis.leader, analysis.study))}."


def _settings(analysis: Analysis) -> Iterator[Setting]:
    """Yield the tuned parameters of default and answer."""
    result = analysis.answer
    if result is None:
        return
    notes = {each.parameter: f"at its {each.side} bound" for each in analysis.verdict.at_bounds}
    defaults, tuned = map(analysis.study.on_screen, (analysis.defaults, result.parameters))
    for name, item in analysis.study.parameters.items():
        if item.is_tuned:
            yield Setting(
                with_unit(item.title_and_name, item.unit),
                number(defaults[name]),
                number(tuned[name]),
                notes.get(name, ""),
                _track(analysis, item),
            )


def _fixed(analysis: Analysis) -> str:
    """Return the parameters that were not tuned, in a line; empty without any."""
    result = analysis.answer
    if result is None:
        return ""
    inactive = analysis.study.search_space().inactive(result.parameters)
    return "; ".join(
        f"{item.title_and_name} {number(result.parameters[name])} "
        f"({f'as {item.tied_to}' if item.tied_to else 'not tuned'})"
        for name, item in analysis.study.parameters.items()
        if not item.is_tuned and name not in inactive
    )


def _track(analysis: Analysis, item: Parameter) -> Track | None:
    """Return where a number is on its range; None for what is none."""
    space, result = analysis.study.search_space(), analysis.answer
    if result is None or item.name not in space.numbers:
        return None
    if item.name in space.inactive(result.parameters):
        return None
    column = space.names.index(item.name)
    tuned = space.to_cube(analysis.tuned_values(result.parameters))
    default = space.to_cube(analysis.tuned_values(analysis.defaults))
    return Track(float(default[column]), float(tuned[column]), _beyond(analysis, item, tuned))


def _beyond(analysis: Analysis, item: Parameter, tuned: np.ndarray) -> list[tuple[float, float]]:
    models, result = analysis.models, analysis.answer
    if result is None or not models.constraints or models.objective is None:
        return []
    grid = parameter_grid(
        analysis.study, item.name, analysis.tuned_values(result.parameters), POINTS
    )
    points = np.tile(tuned, (len(grid.cube), 1))
    points[:, grid.column] = grid.cube
    over = models.feasibility(points) < EVEN
    # Each value stands for what is nearer to it than to its neighbours.
    edges = np.concatenate(([0.0], 0.5 * (grid.cube[1:] + grid.cube[:-1]), [1.0]))
    parts: list[tuple[float, float]] = []
    for k in np.flatnonzero(over):
        begin = edges[k]
        if parts and parts[-1][1] == begin:
            begin, _ = parts.pop()
        parts.append((float(begin), float(edges[k + 1])))
    return parts


def _details(verdict: Verdict) -> Iterator[str]:
    """Yield what else is known of each limit."""
    for quantity in verdict.quantities:
        if more := details(quantity):
            yield f"{quantity.label}: {more}."
