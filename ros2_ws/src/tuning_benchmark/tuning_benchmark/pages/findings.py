"""Findings in sentences: comparison with the paper, and between rows."""

from collections.abc import Mapping, Sequence
from itertools import combinations

import numpy as np

from tuning_benchmark.experiments.experiment import RANDOM, WORST_CASE, Case
from tuning_benchmark.experiments.task_names import point_task
from tuning_benchmark.pages.statistics import CONFIDENCE, Mean, difference, fisher
from tuning_benchmark.pages.summary import Record, RowSummary

CLEAR = 0.005
"""Differences in the paper that are smaller are not judged.

The paper prints three digits, and no spread of its runs.
"""


def beside_the_paper(case: Case, summaries: Sequence[RowSummary]) -> list[str]:
    """Compare each number that the paper prints with ours.

    Shares are compatible unless Fisher's exact test finds a difference. Objectives of two plants
    cannot be compared, but their order can, and so can the sign of the difference between
    validation and training: they agree if ours have the same sign beyond chance. Rows without a
    feasible answer are not ordered, as their low objectives violate the limits.
    """
    sentences = []
    for s in summaries:
        if {"feasible", "runs"} <= s.row.published.keys():
            sentences.append(_about_share(s))
        if _clear(s.row.published.get("difference", 0.0)) and s.difference.count > 1:
            sentences.append(_about_gap(s))
    quoted = [s for s in summaries if "objective" in s.row.published]
    ordered = [s for s in quoted if s.feasible.count > 0]
    for a, b in combinations(ordered, 2):
        paper = a.row.published["objective"] - b.row.published["objective"]
        ours = difference(a.validated_objectives, b.validated_objectives)
        if _clear(paper) and ours.count > 1:
            sentences.append(_about_order(a, b, paper, ours))
    return sentences + [_unordered(case, s, ordered) for s in quoted if s.feasible.count == 0]


def in_brief(case: Case, summaries: Sequence[RowSummary]) -> str:
    """Say in a line which row found most truly feasible answers, and how good they are.

    Among rows with as many, that with the best mean objective is the first.
    """
    sign = case.study.objective.sign
    order = sorted(
        summaries,
        key=lambda s: (-s.feasible.value, sign * s.objective.value if s.objective.count else 0.0),
    )
    best, *others = order
    sentence = _answers(best)
    if others:
        sentence += f"; next {_answers(others[0])}"
    last = order[-1]
    if len(others) > 1 and last.feasible.value < others[0].feasible.value:
        sentence += f"; fewest feasible: {last.row.name}, {_count(last)}"
    return f"{sentence}."


def _count(s: RowSummary) -> str:
    return f"{s.feasible.count} of {s.feasible.runs}"


def _answers(s: RowSummary) -> str:
    text = f"{s.row.name}, {_count(s)} answers truly feasible"
    if s.distance is not None and s.distance.count:
        where = "above" if s.distance.value >= 0.0 else "below"
        return f"{text}, on average {abs(s.distance.value):.1f} % {where} the optimum"
    return f"{text}, mean objective {s.objective.value:.4g}" if s.objective.count else text


def _clear(published: float) -> bool:
    # Without the digits that a difference of two printed numbers does not have.
    return round(abs(published), 6) >= CLEAR


def _about_share(s: RowSummary) -> str:
    runs = round(s.row.published["runs"])
    count = round(s.row.published["feasible"] * runs)
    p = fisher((count, runs), (s.validated.count, s.validated.runs))
    verdict = "Differs" if p < 1.0 - CONFIDENCE else "Compatible"
    return (
        f"{verdict}: answers of {s.row.name} held in the validation in {count} of the paper's "
        f"{runs} runs and in {s.validated.count} of {s.validated.runs} here (p = {p:.2g})."
    )


def _about_gap(s: RowSummary) -> str:
    gap, ours = s.row.published["difference"], s.difference
    start = f"the validation of {s.row.name} differs from its training by {gap:+g} in the paper"
    if _may_be_chance(ours):
        return f"Undecided: {start} and by {_change(ours)} here, which may be chance."
    return f"{_same_sign(gap, ours.value)}: {start} and by {_change(ours)} here."


def _about_order(a: RowSummary, b: RowSummary, paper: float, ours: Mean) -> str:
    start = (
        f"the validated objective of {a.row.name} less that of {b.row.name} is {paper:+.3f} in "
        f"the paper and {_change(ours)} here"
    )
    if _may_be_chance(ours):
        return f"Undecided: {start}, which may be chance."
    return f"{_same_sign(paper, ours.value)}: {start}."


def _unordered(case: Case, s: RowSummary, ordered: Sequence[RowSummary]) -> str:
    sentence = f"No answer of {s.row.name} is truly feasible, so it is not ranked"
    sign = case.study.objective.sign
    others = [sign * o.validation.value for o in ordered if o.validation.count]
    if others and s.validation.count and sign * s.validation.value < min(others):
        sentence += (
            f": its objective is {'low' if sign > 0.0 else 'high'} because it violates the limits"
        )
    return f"{sentence}."


def _same_sign(paper: float, ours: float) -> str:
    return "Agrees in sign" if paper * ours > 0.0 else "Differs"


def _may_be_chance(value: Mean) -> bool:
    return value.low <= 0.0 <= value.high


def _change(value: Mean) -> str:
    return f"{value.value:+.4f} ({value.low:.4f} to {value.high:.4f})"


def about_points(case: Case, done: Mapping[str, Record]) -> list[str]:
    """Compare the paper's verdicts on single parameter sets with ours, and their order.

    Points are compared with the first one whose objective the paper prints. Ours differ if they do
    so by two standard errors of both means, which is cautious, as both share their contexts.
    """
    sentences = []
    first = ""
    for name, point in case.points.items():
        record = done[point_task(case.name, name)]
        if record["failed"]:
            continue
        truth = record["result"]["truth"]
        if "feasible" in point.published:
            sentences.append(_about_feasibility(name, bool(point.published["feasible"]), truth))
        if "objective" not in point.published or truth["objective"] is None:
            continue
        if first:
            paper = point.published["objective"] - case.points[first].published["objective"]
            reference = done[point_task(case.name, first)]["result"]["truth"]
            if _clear(paper):
                sentences.append(_about_distance(name, first, paper, truth, reference))
        else:
            first = name
    return sentences


def _about_feasibility(name: str, paper: bool, truth: Record) -> str:
    verdict = "Agrees" if paper == truth["feasible"] else "Differs"
    theirs, ours = ("feasible" if kept else "infeasible" for kept in (paper, truth["feasible"]))
    return f"{verdict}: *{name}* is {theirs} in the paper and {ours} here."


def _about_distance(name: str, first: str, paper: float, truth: Record, reference: Record) -> str:
    ours = truth["objective"] - reference["objective"]
    error = np.hypot(truth["standard_error"], reference["standard_error"])
    start = (
        f"the objective of *{name}* less that of *{first}* is {paper:+.3f} in the paper and "
        f"{ours:+.4f} here"
    )
    if abs(ours) < 2.0 * error:
        return f"Differs: {start}, which is within two standard errors."
    return f"{_same_sign(paper, ours)}: {start}."


def beside_others(case: Case, summaries: Sequence[RowSummary]) -> list[str]:
    """Compare the best of the tuner's algorithms with all other rows, at equal budgets.

    The reference is the algorithm with the most truly feasible answers; the better objective breaks
    ties. The intervals and tests are corrected for the number of comparisons (Bonferroni).
    """
    ours = [s for s in summaries if s.row.algorithm]
    if not ours or not any(s.row.optimizer for s in summaries):
        return []
    sign = case.study.objective.sign
    best = max(ours, key=lambda s: _quality(s, sign))
    others = [s for s in summaries if s is not best]
    level = (1.0 - CONFIDENCE) / len(others)
    sentences = [
        f"The reference is {best.row.name}: {_quoted(best)}.",
        f"Each of the {len(others)} comparisons is made at a confidence of {1.0 - level:.2%}, so "
        f"that all comparisons of counts, and all of objectives, hold jointly at {CONFIDENCE:.0%} "
        f"(Bonferroni).",
    ]
    sentences += [_about(best, s, level, sign) for s in others]
    drawn = [s for s in others if s.row.protocol == RANDOM]
    lent = [s for s in others if s.row.protocol == WORST_CASE and s.row.optimizer]
    for group, words in ((drawn, "random contexts"), (lent, "our worst-case search")):
        if group:
            sentences.append(_best_of(group, words, sign))
    return sentences


def _quality(s: RowSummary, sign: float) -> tuple[int, float]:
    return s.feasible.count, -sign * s.objective.value if s.objective.count else -np.inf


def _best_of(group: Sequence[RowSummary], words: str, sign: float) -> str:
    top = max(group, key=lambda s: _quality(s, sign))
    if top.feasible.count == 0:
        return f"None with {words} has a truly feasible answer."
    return f"The best with {words} is {top.row.name}: {_quoted(top)}."


def _quoted(s: RowSummary) -> str:
    counts = f"{s.feasible.count} of {s.feasible.runs} answers truly feasible"
    if s.objective.count == 0:
        return f"{counts}, so there is no objective to compare"
    return f"{counts}, their mean objective {s.objective.value:.4f}"


def _about(best: RowSummary, other: RowSummary, level: float, sign: float) -> str:
    verdicts = [_about_counts(best, other, level)]
    gap = difference(other.feasible_objectives, best.feasible_objectives, 1.0 - level)
    if gap.count > 1:
        change = f"{_change(gap)} over {gap.count} runs"
        if _may_be_chance(gap):
            verdicts.append(f"no difference of the objective beyond chance, {change}")
        elif sign * gap.value < 0.0:
            verdicts.append(f"**a better objective where both are feasible, by {change}**")
        else:
            verdicts.append(f"a worse objective where both are feasible, by {change}")
    return f"{other.row.name}: {_quoted(other)}: {'; '.join(verdicts)}."


def _about_counts(best: RowSummary, other: RowSummary, level: float) -> str:
    own, reference = other.feasible, best.feasible
    if own.count == reference.count:
        return "as many feasible answers as the reference"
    if fisher((own.count, own.runs), (reference.count, reference.runs)) >= level:
        return (
            f"no difference of feasible answers beyond chance ({own.count} against "
            f"{reference.count} of {reference.runs})"
        )
    if own.count < reference.count:
        return "fewer feasible answers than the reference"
    return "**more feasible answers than the reference**"
