"""The answer at the top of a report: the result of the run, or its state so far."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

from bo_tuner.report.analysis import Analysis
from bo_tuner.report.content import Table, change, number, quantity
from bo_tuner.study.parts import CHANCE, EXPECTATION, MINIMIZE, Constraint
from bo_tuner.tuning.limits import Sample
from bo_tuner.tuning.validation import Validation


class Status(StrEnum):
    """Whether a result is good; open while the run has none."""

    GOOD = "good"
    WARNING = "warning"
    BAD = "bad"
    OPEN = "open"


@dataclass(frozen=True)
class Tile:
    """A key figure: the tuned value, a remark with its reference, and its status."""

    label: str
    value: str
    unit: str
    remark: str
    status: Status = Status.OPEN


@dataclass(frozen=True)
class Answer:
    """The content of the top of a report.

    Attributes
    ----------
    status
        Status of the result.
    title
        The result in one line.
    sentences
        The explanation.
    tiles
        Key figures.
    table
        Default and tuned parameter set, side by side.
    """

    status: Status
    title: str
    sentences: Sequence[str]
    tiles: Sequence[Tile]
    table: Table


def answer(analysis: Analysis) -> Answer:
    """Return the answer of a run, or its state so far."""
    if analysis.validations is None:
        return _so_far(analysis)
    default, tuned = analysis.validations
    study = analysis.study
    metric = study.metrics[study.objective.metric]
    found_feasible = analysis.believed_feasible
    if found_feasible and default.feasible:
        status, title = Status.GOOD, "The tuned parameter set keeps all limits, as does the default"
    elif found_feasible:
        status = Status.GOOD
        title = "The tuned parameter set keeps all limits; the default does not"
    elif tuned.feasible:
        status, title = Status.BAD, "No parameter set was found to be feasible"
    else:
        status, title = Status.BAD, "No parameter set kept all limits in the validation"
    sentences = [
        f"Mean {metric.name} {quantity(tuned.objective, metric.unit)}, "
        f"{change(tuned.objective, default.objective)} relative to the default, on the same "
        f"{tuned.draws} fresh draws of context and noise{_paired(analysis, metric.unit)}.",
        _holds("The tuned parameter set", tuned),
        _holds("The default", default),
    ]
    if not found_feasible:
        sentences.append("best.yaml holds the least violating one; do not use it as it is.")
    elif default.feasible and not _better(analysis, tuned.objective, default.objective):
        status = Status.WARNING
        sentences.append("The default is feasible as well and not worse: tuning gained nothing.")
    tiles = _tiles(analysis, default, tuned)
    certificate = analysis.certificate
    if certificate is not None:
        passed = Status.GOOD if certificate.passed else Status.BAD
        verdict = "PASS" if certificate.passed else "FAIL"
        of_another = analysis.answer is None or certificate.trial != analysis.answer.number
        scope = certificate.scope
        if of_another:
            passed, scope = Status.WARNING, f"of trial {certificate.trial}, which is not the result"
        tiles.insert(0, Tile("certificate", verdict, "", scope, passed))
        if not certificate.passed and not of_another:
            status = Status.BAD
            sentences += [f"The certificate failed: {why}." for why in certificate.reasons]
    return Answer(
        status=status,
        title=title,
        sentences=sentences,
        tiles=tiles,
        table=_comparison(analysis, default, tuned),
    )


def _so_far(analysis: Analysis) -> Answer:
    record, study = analysis.record, analysis.study
    done, planned = len(record.trials), study.budget.trials
    complete = len(analysis.ranked) > 0
    if done < planned:
        title = f"No result yet: {done} of {planned} trials"
    elif complete:
        title = f"No result yet: all {planned} trials are done but not validated"
    else:
        title = "No result: no trial is complete"
    sentences = ["The run is in progress, or ended before its validation."] if complete else []
    tiles: list[Tile] = []
    if not complete:
        failed = sum(analysis.outcome(trial) == "failed" for trial in analysis.trials)
        sentences.append(f"{failed} trials failed; see the section on failures.")
    else:
        leader = analysis.ranked[0]
        metric = study.metrics[study.objective.metric]
        sentences.append(
            f"Trial {leader.trial.number} is the best so far: predicted mean {metric.name} "
            f"{quantity(leader.objective, metric.unit)}, feasible with probability "
            f"{leader.feasibility:.2f}."
            if leader.believed_feasible
            else f"No trial is believed feasible; the least violating one is trial "
            f"{leader.trial.number}, feasible with probability {leader.feasibility:.2f}."
        )
        tiles = [
            Tile(f"mean {metric.name}, predicted", number(leader.objective), metric.unit, ""),
            Tile("feasible with probability", f"{leader.feasibility:.2f}", "", ""),
        ]
    parameters = analysis.answer.parameters if analysis.answer is not None else None
    rows = [
        [name, number(value), number(parameters[name]) if parameters else "–", item.unit, ""]
        for (name, value), item in zip(
            analysis.defaults.items(), study.parameters.values(), strict=True
        )
    ]
    table = _table(rows, "Default and best parameter set so far", "best so far")
    return Answer(Status.OPEN, title, sentences, tiles, table)


def _tiles(analysis: Analysis, default: Validation, tuned: Validation) -> list[Tile]:
    study = analysis.study
    metric = study.metrics[study.objective.metric]
    better = _better(analysis, tuned.objective, default.objective)
    tiles = [
        Tile(
            f"mean {metric.name}",
            number(tuned.objective),
            metric.unit,
            f"default {number(default.objective)}, {change(tuned.objective, default.objective)}",
            Status.GOOD if better else Status.WARNING,
        )
    ]
    for name, constraint in study.constraints.items():
        ours, theirs = tuned.constraints[name], default.constraints[name]
        limit = f"limit {number(constraint.upper)}"
        tiles.append(
            Tile(
                f"largest {constraint.metric}",
                number(ours.worst),
                study.metrics[constraint.metric].unit,
                f"{limit}, default {number(theirs.worst)}",
                Status.GOOD if ours.holds else Status.BAD,
            )
        )
    return tiles


def _comparison(analysis: Analysis, default: Validation, tuned: Validation) -> Table:
    study = analysis.study
    metric = study.metrics[study.objective.metric]
    both = (default, tuned)
    rows = [
        [name, *(number(v.parameters.get(name)) for v in both), item.unit, ""]
        for name, item in study.parameters.items()
    ]
    rows.append([f"mean {metric.name}", *(number(v.objective) for v in both), metric.unit, ""])
    rows.append(
        [
            f"  standard error of the mean {metric.name}",
            *(number(v.deviation / math.sqrt(v.draws - v.failures)) if v.draws > v.failures else "–"
              for v in both),
            metric.unit,
            "",
        ]
    )  # fmt: skip
    for name, constraint in study.constraints.items():
        samples = [v.constraints[name] for v in both]
        unit = study.metrics[constraint.metric].unit
        limit = f"≤ {number(constraint.upper)}"
        rows.append(
            [f"largest {constraint.metric}", *(number(s.worst) for s in samples), unit, limit]
        )
        rows.append(
            [
                f"  draws above {number(constraint.upper)}",
                *(f"{s.violations} of {s.count}" for s in samples),
                "",
                _allowed(constraint),
            ]
        )  # fmt: skip
    rows.append(["failed evaluations", *(str(v.failures) for v in both), "", "0"])
    rows.append(["feasible", *("yes" if v.feasible else "no" for v in both), "", ""])
    draws = f"on the same {tuned.draws} fresh draws of context and noise"
    return _table(rows, f"Default and tuned parameter set {draws}")


def _table(rows: Sequence[Sequence[str]], caption: str, tuned: str = "tuned") -> Table:
    header = ["", "default", tuned, "unit", "limit"]
    return Table(caption=caption, header=header, rows=rows, numeric=[1, 2, 4])


def _allowed(constraint: Constraint) -> str:
    if constraint.statistic == EXPECTATION:
        return "mean counts"
    where = "" if constraint.kind == CHANCE else " in any context"
    return f"≤ {100.0 * constraint.allowed:.3g} %{where}"


def _paired(analysis: Analysis, unit: str) -> str:
    """Return the paired difference, from which the spread between draws cancels."""
    difference = analysis.paired_difference()
    if difference is None:
        return ""
    mean, error = difference
    return f" (paired difference {mean:+.3g} ± {error:.2g}{f' {unit}' if unit else ''})"


def _holds(who: str, validation: Validation) -> str:
    parts = [_broken(s) for s in validation.constraints.values() if not s.holds]
    if validation.failures:
        parts.append(f"{validation.failures} of {validation.draws} evaluations failed")
    return f"{who} keeps all limits." if not parts else f"{who} fails: {', '.join(parts)}."


def _broken(sample: Sample) -> str:
    return f"{sample.name} violated in {sample.violations} of {sample.count} draws"


def _better(analysis: Analysis, value: float, reference: float) -> bool:
    minimized = analysis.study.objective.direction == MINIMIZE
    return value < reference if minimized else value > reference
