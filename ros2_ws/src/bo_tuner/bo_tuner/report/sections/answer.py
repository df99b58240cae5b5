"""The first screen of a report: the verdict on the result, its numbers, and what to do next."""

from collections.abc import Sequence
from dataclasses import dataclass

from bo_tuner.deploy.bundle import DEPLOY
from bo_tuner.evidence.differences import CONFIDENCE, Change
from bo_tuner.evidence.next_steps import Step, next_steps
from bo_tuner.evidence.verdict import Quantity, Status, Verdict
from bo_tuner.monitoring.progress import incumbent_in_words
from bo_tuner.report.analysis import Analysis
from bo_tuner.report.content import Table, number
from bo_tuner.storage.run_files import BAGS
from bo_tuner.storage.run_folder import BEST, JOURNAL
from bo_tuner.study.function_study import FUNCTION
from bo_tuner.study.limits import Standing

FILES = (
    (BEST, "the tuned parameters"),
    (f"{DEPLOY}/", "bundle with rollback and digests"),
    ("trials.csv", "all trials"),
    ("evaluations.csv", "all evaluations"),
    (JOURNAL, "the record"),
    (f"{BAGS}/", "bags of notable trials"),
    ("certificates/", "certificates"),
)


MOST_NUMBERS = 3
"""Numbers beside the certificate: more tiles than four are not read at a glance."""


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
    verdict
        The verdict, with its words.
    sentences
        The explanation.
    tiles
        Key figures.
    steps
        Commands that come next.
    files
        Names of the files and folders of the run that exist, with their content.
    table
        Default and tuned parameter set, side by side.
    notes
        What else the table needs to be read.
    """

    verdict: Verdict
    sentences: Sequence[str]
    tiles: Sequence[Tile]
    steps: Sequence[Step]
    files: Sequence[tuple[str, str]]
    table: Table
    notes: Sequence[str]


def answer(analysis: Analysis) -> Answer:
    """Return the answer of a run, or its state so far."""
    verdict, record = analysis.verdict, analysis.record
    sentences = list(verdict.sentences)
    if verdict.quantities:
        tiles, table = _tiles(analysis), _comparison(analysis)
    else:
        tiles, table = [], _parameters(analysis)
        leader = analysis.leader
        found = incumbent_in_words(leader, analysis.study)
        sentences.append(f"{found[0].upper()}{found[1:]}.")
    return Answer(
        verdict=verdict,
        sentences=sentences,
        tiles=tiles,
        # The page may be opened from any folder. Commands do not reach a function.
        steps=() if record.backend == FUNCTION else next_steps(verdict, str(record.path.resolve())),
        files=[(name, what) for name, what in FILES if (record.path / name).exists()],
        table=table,
        notes=[f"{line}." for line in verdict.draws_in_words],
    )


def _tiles(analysis: Analysis) -> list[Tile]:
    """Return the certificate, and the numbers that matter most."""
    verdict = analysis.verdict
    tiles = [_of_quantity(q) for q in _that_matter(analysis)]
    found, result = analysis.certificate, analysis.answer
    if found is not None and result is not None and found.is_of(result):
        tiles.insert(0, Tile("certificate", verdict.certificate, "", [found.scope], verdict.status))
    elif found is not None:
        scope = f"of trial {found.trial}, which is not the result"
        tiles.insert(0, Tile("certificate", found.verdict, "", [scope], Status.WARNING))
    else:
        value = "not readable" if analysis.certificate_problem else "none yet"
        tiles.insert(0, Tile("certificate", value, "", ["run validate"], Status.OPEN))
    return tiles


def _that_matter(analysis: Analysis) -> list[Quantity]:
    """Return the numbers with a tile in the order of the verdict: `MOST_NUMBERS`, if possible.

    Each limit that is violated has one. Then come the worst case, the objective, the other metrics
    without a limit, and the other limits; all others stand in the table.
    """
    study, found = analysis.study, analysis.verdict.quantities
    limited = {constraint.metric for constraint in study.constraints.values()}
    worst = {constraint.metric for constraint in study.worst_case_constraints}

    def rank(quantity: Quantity) -> int:
        if _violated(quantity):
            return 0
        if quantity.found is not None and quantity.metric in worst:
            return 1
        if quantity.metric == study.objective.metric:
            return 2
        return 3 if quantity.found is None else 4

    eligible = [q for q in found if q.found is not None or q.metric not in limited]
    broken = sum(map(_violated, eligible))
    chosen = sorted(eligible, key=rank)[: max(MOST_NUMBERS, broken)]
    return [quantity for quantity in found if quantity in chosen]


def _violated(quantity: Quantity) -> bool:
    return quantity.found is not None and quantity.found.standing is Standing.VIOLATED


def _of_quantity(quantity: Quantity) -> Tile:
    default, tuned = quantity.values_in_words
    remarks = [f"default {default}"]
    if quantity.found is not None:
        remarks[0] += f", limit {quantity.limit_in_words}: {quantity.found.words}"
    if quantity.difference is not None:
        remarks.append(f"{quantity.change}: {quantity.change_in_words}")
    remarks += filter(None, (quantity.bound_in_words, quantity.draws, quantity.remark))
    return Tile(quantity.label, tuned, quantity.unit, remarks, _status(quantity))


def _status(quantity: Quantity) -> Status:
    """Return the mark of a number: good only for a limit that is shown to be kept."""
    if (found := quantity.found) is not None:
        if found.standing is Standing.OPEN:
            return Status.WARNING if found.exceeds else Status.OPEN
        return Status.GOOD if found.standing is Standing.SHOWN else Status.BAD
    marks = {Change.BETTER: Status.GOOD, Change.WORSE: Status.WARNING}
    return marks.get(quantity.change, Status.OPEN)


def _comparison(analysis: Analysis) -> Table:
    verdict = analysis.verdict
    rows = _parameter_rows(analysis)
    for quantity in verdict.quantities:
        rows.append(
            [
                quantity.label,
                *quantity.values_in_words,
                quantity.unit,
                quantity.change_in_words,
                str(quantity.change) if quantity.difference is not None else "",
                quantity.limit_in_words,
            ]
        )
    rows.append(["keeps all limits", *verdict.keeps_in_words, *[""] * 4])
    return Table(
        caption=f"Default and tuned parameter set in {verdict.evidence}; differences are tuned "
        f"minus default with their {100.0 * CONFIDENCE:g} % confidence interval",
        header=["", "default", "tuned", "unit", "difference", "", "limit"],
        rows=rows,
        numeric=[1, 2, 4, 6],
    )


def _parameter_rows(analysis: Analysis) -> list[list[str]]:
    parameters = analysis.answer.parameters if analysis.answer is not None else {}
    return [
        [name, number(value), number(parameters.get(name)), item.unit, *[""] * 3]
        for (name, value), item in zip(
            analysis.defaults.items(), analysis.study.parameters.values(), strict=True
        )
    ]


def _parameters(analysis: Analysis) -> Table:
    return Table(
        caption="Default and best parameter set so far",
        header=["", "default", "best so far", "unit"],
        rows=[row[:4] for row in _parameter_rows(analysis)],
        numeric=[1, 2],
    )
