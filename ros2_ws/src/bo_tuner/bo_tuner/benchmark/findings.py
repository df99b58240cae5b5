"""What the numbers say, in plain sentences: beside the paper, and between rows."""

from collections.abc import Sequence
from itertools import combinations

import numpy as np

from bo_tuner.benchmark.experiment import Case
from bo_tuner.benchmark.experiment_parts import RANDOM
from bo_tuner.benchmark.statistics import difference
from bo_tuner.benchmark.summary import RowSummary

VAGUE = 0.65
"""A confidence interval of a share that is wider says too little to agree with anything.

With ten runs it is at most 0.63 wide.
"""


def beside_the_paper(summaries: Sequence[RowSummary]) -> list[str]:
    """Compare each number that the paper prints with ours.

    A share agrees if it lies in our confidence interval, unless that leaves most open. Objectives
    of two plants cannot be compared, but their order can, and the sign of what the validation adds
    to the training: they agree if ours are the same beyond chance.
    """
    said = []
    for s in summaries:
        share = s.row.published.get("feasible")
        if share is not None:
            agrees = s.validated.low <= share <= s.validated.high
            vague = s.validated.high - s.validated.low > VAGUE
            verdict = "Differs" if not agrees else "Undecided" if vague else "Agrees"
            said.append(
                f"{verdict}: answers of {s.row.name} held in the "
                f"validation in {share:.0%} of the paper's runs and in {s.validated.count} of "
                f"{s.validated.runs} here ({s.validated.low:.0%} to {s.validated.high:.0%})."
            )
        gap = s.row.published.get("difference")
        if gap is not None and s.difference.count > 1:
            said.append(_about_gap(s, gap))
    quoted = [s for s in summaries if "objective" in s.row.published]
    for a, b in combinations([s for s in quoted if len(_validated(s)) > 1], 2):
        said.append(_about_order(a, b))
    return said


def _about_gap(s: RowSummary, gap: float) -> str:
    ours = s.difference
    here = f"{ours.value:+.4f} ({ours.low:.4f} to {ours.high:.4f})"
    start = f"the validation of {s.row.name} differs from its training by {gap:+g} in the paper"
    if ours.low <= 0.0 <= ours.high:
        return f"Undecided: {start} and by {here} here, which may be chance."
    verdict = "Agrees in sign" if gap * ours.value > 0.0 else "Differs"
    return f"{verdict}: {start} and by {here} here."


def _about_order(a: RowSummary, b: RowSummary) -> str:
    paper = a.row.published["objective"] - b.row.published["objective"]
    ours = difference(_validated(a), _validated(b))
    here = f"{ours.value:+.4f} ({ours.low:.4f} to {ours.high:.4f}) here"
    start = (
        f"the validated objective of {a.row.name} less that of {b.row.name} is {paper:+.3f} in "
        f"the paper and {here}"
    )
    if ours.low <= 0.0 <= ours.high:
        return f"Undecided: {start}, which may be chance."
    return f"{'Agrees in sign' if paper * ours.value > 0 else 'Differs'}: {start}."


def _validated(s: RowSummary) -> list[float]:
    values = [a["validation"]["objective"] for a in s.answers]
    return [value for value in values if value is not None]


def beside_others(case: Case, summaries: Sequence[RowSummary]) -> list[str]:
    """Compare the product's algorithms with the other optimizers, at equal cuts.

    The reference is the algorithm with the most truly feasible answers, the lower objective
    deciding between equals.
    """
    ours = [s for s in summaries if s.row.algorithm]
    others = [s for s in summaries if s.row.optimizer]
    if not ours or not others:
        return []
    best = max(ours, key=_quality)
    said = [
        f"The reference is {best.row.name}: {best.feasible.count} of {best.feasible.runs} answers "
        f"truly feasible, {_objective(best)}."
    ]
    said += [_about(best, s) for s in others]
    for protocol, words in ((True, "random contexts"), (False, "the worst-case search lent to it")):
        group = [s for s in others if (s.row.protocol == RANDOM) is protocol]
        if group:
            top = max(group, key=_quality)
            said.append(
                f"The best with {words} is {top.row.name}: {top.feasible.count} of "
                f"{top.feasible.runs} truly feasible, {_objective(top)}."
            )
    return said


def _quality(s: RowSummary) -> tuple[int, float]:
    objective = s.objective.value if s.objective.count else np.inf
    return s.feasible.count, -objective


def _objective(s: RowSummary) -> str:
    if s.objective.count == 0:
        return "so that it has no objective to compare"
    return f"their mean objective {s.objective.value:.4f}"


def _about(best: RowSummary, other: RowSummary) -> str:
    start = (
        f"{other.row.name}: {other.feasible.count} of {other.feasible.runs} truly feasible, "
        f"{_objective(other)}"
    )
    if other.feasible.count < best.feasible.count:
        verdict = "fewer feasible answers than the reference"
    elif other.feasible.count > best.feasible.count:
        verdict = "**more feasible answers than the reference**"
    else:
        verdict = "as many feasible answers as the reference"
    gap = difference(other.feasible_objectives, best.feasible_objectives)
    if np.isfinite(gap.low):
        change = f"{gap.value:+.4f} ({gap.low:.4f} to {gap.high:.4f})"
        if gap.high < 0.0:
            verdict += f"; **a better objective among feasible ones by {change}**"
        elif gap.low > 0.0:
            verdict += f"; a worse objective among feasible ones by {change}"
        else:
            verdict += f"; no difference of the objective beyond chance, {change}"
    return f"{start}: {verdict}."
