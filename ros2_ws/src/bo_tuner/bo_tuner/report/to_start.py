"""Commands that the page of a run may start: those that it shows, and no others."""

import shlex

from bo_tuner.report.analysis import Analysis
from bo_tuner.report.sections.answer import steps
from bo_tuner.report.sections.front import steps_of_front
from bo_tuner.report.sections.what_if import command

SET = "--set"


def to_start(analysis: Analysis, asked: str) -> list[str] | None:
    """Return the words of a command that the page shows and may start; None for any other."""
    try:
        words = shlex.split(asked)
    except ValueError:
        return None
    shown = [step for step in (*steps(analysis), *steps_of_front(analysis)) if step.may_start]
    if any(shlex.split(step.command) == words for step in shown):
        return words
    return words if _is_of_sliders(analysis, words) else None


def _is_of_sliders(analysis: Analysis, words: list[str]) -> bool:
    """Return whether it is the command of the sliders, with a number for each."""
    begin = shlex.split(command(analysis))
    behind = words[len(begin) :]
    if not begin or words[: len(begin)] != begin or behind[::2] != [SET] * len(behind[1::2]):
        return False
    given = dict(word.partition("=")[::2] for word in behind[1::2])
    numbers = analysis.study.search_space().numbers
    return set(given) == set(numbers) and all(map(_is_number, given.values()))


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True
