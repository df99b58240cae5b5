"""The first screen of a report: the verdict on the result, its numbers, and what to do next."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from math import isfinite

from bo_tuner.deploy.bundle import DEPLOY
from bo_tuner.evidence.differences import CONFIDENCE, Change
from bo_tuner.evidence.next_steps import Step, next_steps
from bo_tuner.evidence.verdict import FAIL, PASS, Quantity, State, Status, Verdict
from bo_tuner.evidence.what_to_set import what_to_set
from bo_tuner.figures.figure import Figure
from bo_tuner.monitoring.progress import incumbent_in_words
from bo_tuner.report.analysis import Analysis
from bo_tuner.report.content import Table, number
from bo_tuner.report.sections.trajectories import response
from bo_tuner.storage.parameter_file import node_values, sent_values, to_yaml
from bo_tuner.storage.run_files import BAGS
from bo_tuner.storage.run_folder import BEST, JOURNAL
from bo_tuner.study.function_study import FUNCTION
from bo_tuner.study.limits import Standing
from bo_tuner.text import capitalized, with_unit

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
MOST_LIMITS = 4
"""Limits that a tile has room for; the table has all."""


@dataclass(frozen=True)
class Tile:
    """A key figure: the tuned value, remarks with its references, and its status."""

    label: str
    value: str
    unit: str
    remarks: Sequence[str]
    status: Status = Status.OPEN


@dataclass(frozen=True)
class Answer:
    """The content of the first screen of a report.

    Attributes
    ----------
    headline
        What to set, and why, in one line.
    status
        How good that is, as a mark.
    advice
        What to change where nothing was found feasible.
    values
        The parameters of default and result; None before there is any.
    file
        The values as a parameter file, to copy; empty if they are not to be used.
    tiles
        Objective, limits and trust.
    figure
        Default and result over time; None if there are no signals.
    sentences
        The explanation.
    remarks
        What else to know.
    steps
        Commands that come next.
    files
        Names of the files and folders of the run that exist, with their content.
    table
        The numbers of default and result, side by side; None before there are any.
    """

    headline: str
    status: Status
    advice: Sequence[str]
    values: Table | None
    file: str
    tiles: Sequence[Tile]
    figure: Figure | None
    sentences: Sequence[str]
    remarks: Sequence[str]
    steps: Sequence[Step]
    files: Sequence[tuple[str, str]]
    table: Table | None


def answer(analysis: Analysis) -> Answer:
    """Return the answer of a run, or its state so far."""
    verdict, record, study = analysis.verdict, analysis.record, analysis.study
    result = analysis.answer
    parameters = {} if result is None else result.parameters
    remarks = set(verdict.remarks)
    advice = verdict.advice
    apart = {*remarks, *advice}
    sentences = [line for line in verdict.sentences if line not in apart]
    if verdict.quantities:
        tiles = [*_objectives(verdict), *_limits(analysis), _trust(analysis)]
    else:
        tiles = []
        words = incumbent_in_words(analysis.leader, study)
        sentences.append(f"{capitalized(words)}.")
    usable = verdict.feasible and result is not None
    return Answer(
        headline=what_to_set(study, verdict, parameters),
        status=verdict.status,
        advice=advice,
        values=_values(analysis),
        file=to_yaml(node_values(study, parameters), sent_values(study, parameters))
        if usable
        else "",
        tiles=tiles,
        figure=response(analysis),
        sentences=sentences,
        remarks=[
            *verdict.remarks,
            *(f"{line}." for line in verdict.draws_in_words),
            *_details(verdict),
        ],
        # The page may be opened from any folder. Commands do not reach a function.
        steps=() if record.backend == FUNCTION else next_steps(verdict, str(record.path.resolve())),
        files=[
            (name, DO_NOT_USE if name == BEST and verdict.state in NOT_TO_USE else what)
            for name, what in FILES
            if (record.path / name).exists()
        ],
        table=_comparison(analysis) if verdict.quantities else None,
    )


def _objectives(verdict: Verdict) -> Iterator[Tile]:
    """Yield a tile for each objective, the first one of the study first."""
    for quantity in verdict.quantities:
        if quantity.objective:
            default, tuned = quantity.values_in_words
            change = str(quantity.change)
            if quantity.difference is not None:
                change = f"{change}: {quantity.change_in_words}"
            remarks = [f"default {default}", change, quantity.basis]
            marks = {Change.BETTER: Status.GOOD, Change.WORSE: Status.WARNING}
            yield Tile(
                f"objective: {quantity.label}",
                tuned,
                quantity.unit,
                list(filter(None, remarks)),
                marks.get(quantity.change, Status.OPEN),
            )


def _limits(analysis: Analysis) -> list[Tile]:
    """Return the tile of all limits, the worst of them first; none without limits."""
    order = (Status.BAD, Status.WARNING, Status.OPEN, Status.GOOD)
    limited = [q for q in analysis.verdict.quantities if q.limit_verdict is not None]
    limited.sort(key=lambda quantity: order.index(_status(quantity)))
    if not limited:
        return []
    status = _status(limited[0])
    if analysis.verdict.standing is Standing.VIOLATED:
        status = Status.BAD
    conditional = any(q.limit_verdict.condition for q in limited if q.limit_verdict)
    value = {
        Status.BAD: "no",
        Status.WARNING: "more runs over a limit than permitted",
        Status.OPEN: "not proven",
        Status.GOOD: "shown with an assumption" if conditional else "proven",
    }[status]
    remarks = [_limit(quantity) for quantity in limited[:MOST_LIMITS]]
    if len(limited) > MOST_LIMITS:
        remarks.append(f"{len(limited) - MOST_LIMITS} more are in the table below")
    return [Tile("within all limits", value, "", remarks, status)]


def _limit(quantity: Quantity) -> str:
    default, tuned = quantity.values_in_words
    words = "" if quantity.limit_verdict is None else quantity.limit_verdict.words
    return f"{quantity.label} {tuned} (default {default}), limit {quantity.limit_in_words}: {words}"


def _details(verdict: Verdict) -> Iterator[str]:
    """Yield what else is known of each limit."""
    for quantity in verdict.quantities:
        if more := "; ".join(filter(None, (quantity.bound_in_words, quantity.remark))):
            yield f"{quantity.label}: {more}."


def _status(quantity: Quantity) -> Status:
    """Return the mark of a limit: good only for one that is proven to be kept."""
    if (limit := quantity.limit_verdict) is None or limit.standing is Standing.OPEN:
        return Status.WARNING if limit is not None and limit.exceeds else Status.OPEN
    return Status.GOOD if limit.standing is Standing.SHOWN else Status.BAD


def _trust(analysis: Analysis) -> Tile:
    """Return the tile of the certificate."""
    verdict = analysis.verdict
    certificate, result = analysis.certificate, analysis.answer
    if certificate is not None and result is not None and certificate.is_of(result):
        # An objective that got worse is no matter of trust.
        status = Status.GOOD if verdict.state is State.CERTIFIED else verdict.status
        return Tile("trust", verdict.certificate, "", [certificate.scope], status)
    if certificate is not None:
        scope = f"of trial {certificate.trial}, which is not the result"
        value = PASS if certificate.passed else FAIL
        return Tile("trust", value, "", [scope], Status.WARNING)
    if analysis.certificate_problem:
        return Tile("trust", "certificate not readable", "", ["run validate again"], Status.WARNING)
    if verdict.state is State.INFEASIBLE:
        return Tile("trust", "do not use it", "", [*verdict.reasons, verdict.evidence], Status.BAD)
    if verdict.state is State.UNPROVEN:
        return Tile("trust", "not proven", "", [*verdict.reasons, verdict.evidence], Status.WARNING)
    return Tile("trust", verdict.trust, "", [verdict.evidence, "validate certifies it"])


def _values(analysis: Analysis) -> Table | None:
    """Return the parameters of default and answer, those that are tuned first."""
    result = analysis.answer
    if result is None:
        return None
    marks = {each.parameter: f"at its {each.side} bound" for each in analysis.verdict.at_bounds}
    items = sorted(analysis.study.parameters.items(), key=lambda pair: not pair[1].is_tuned)
    marks |= {
        name: f"as {item.tied_to}" if item.tied_to else "not tuned"
        for name, item in items
        if not item.is_tuned
    }
    return Table(
        caption=f"Values of the {analysis.answer_set}",
        header=["parameter", analysis.answer_name, "default"],
        rows=[
            [
                with_unit(item.title_and_name, item.unit)
                + (f" ({marks[name]})" if name in marks else ""),
                number(result.parameters[name]),
                number(analysis.defaults[name]),
            ]
            for name, item in items
        ],
        numeric=[1, 2],
        marked=[k for k, (_, item) in enumerate(items) if item.is_tuned],
    )


def _comparison(analysis: Analysis) -> Table:
    verdict = analysis.verdict
    rows = []
    for quantity in verdict.quantities:
        name = f"objective: {quantity.label}" if quantity.objective else quantity.label
        change = str(quantity.change) if quantity.difference is not None else ""
        if change and quantity.difference is not None and isfinite(quantity.difference.mean):
            change += f": {quantity.change_in_words}"
        rows.append(
            [
                with_unit(name, quantity.unit),
                *quantity.values_in_words,
                change,
                quantity.limit_in_words,
            ]
        )
    rows.append(["keeps all limits", *verdict.keeps_in_words, "", ""])
    return Table(
        caption=f"Default and tuned parameter set in {verdict.evidence}; differences are tuned "
        f"minus default with their {100.0 * CONFIDENCE:g} % confidence interval (CI)",
        header=["", "default", "tuned", "difference", "limit"],
        rows=rows,
        numeric=[1, 2, 4],
    )
