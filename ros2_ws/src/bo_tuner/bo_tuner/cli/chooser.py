"""Choose some of what running nodes offer: by an option, or on a terminal."""

import re
import sys
from collections.abc import Callable, Sequence
from typing import TypeVar

from rich.table import Table

from bo_tuner.cli.streams import ask, say_error
from bo_tuner.codec import checks
from bo_tuner.errors import StudyError
from bo_tuner.interruption import Interruption
from bo_tuner.monitoring.display import plain_console
from bo_tuner.terminal import print_table
from bo_tuner.text import one_line

SPAN = re.compile(r"([0-9]{1,6})(?:-([0-9]{1,6}))?")
Offer = TypeVar("Offer")
Row = Callable[[Offer], Sequence[str]]


class Chooser:
    """Lets the user choose: by an option, on a terminal, or else as suggested."""

    def __init__(self, interruption: Interruption) -> None:
        self._interruption = interruption

    def choose(
        self,
        what: str,
        given: Sequence[str] | None,
        offers: Sequence[Offer],
        suggested: Sequence[Offer],
        names: Callable[[Offer], Sequence[str]],
        row: Row[Offer],
    ) -> list[Offer]:
        """Return the offers that are chosen, at least one."""
        if given is not None:
            return _named(what, given, offers, names)
        chosen = list(suggested)
        if offers and sys.stdin.isatty():
            chosen = self._asked(what, offers, suggested, row)
        if not chosen:
            known = [names(offer)[0] for offer in offers]
            hint = f"name some of {', '.join(known[:10])}" if known else "there are none"
            why = "nothing is chosen" if suggested or not known else "no name tells which to take"
            raise StudyError(f"--{what}: {why}; {hint}")
        return chosen

    def _asked(
        self, what: str, offers: Sequence[Offer], suggested: Sequence[Offer], row: Row[Offer]
    ) -> list[Offer]:
        table = Table(title=what, title_justify="left", show_header=False)
        for column in ("number", "suggested", "name", "now", "remark"):
            table.add_column(column)
        for index, offer in enumerate(offers, start=1):
            mark = "*" if offer in suggested else ""
            table.add_row(f"{index}", mark, *(one_line(cell) for cell in row(offer)))
        print_table(plain_console(), table, heading=3, remarks=True)
        while True:
            answer = ask(
                f"{what}: numbers such as 1 3-5, or Enter for those with *: ", self._interruption
            )
            if answer is None:
                raise StudyError(f"--{what}: the input has ended without an answer")
            if not answer:
                return list(suggested)
            try:
                return [offers[i - 1] for i in numbers(answer, len(offers))]
            except StudyError as error:
                say_error(str(error))


def numbers(text: str, most: int) -> list[int]:
    """Return the numbers from 1 to `most` that a text such as ``1 3-5`` lists, in order."""
    chosen: set[int] = set()
    for word in text.replace(",", " ").split():
        match = SPAN.fullmatch(word)
        low, high = (int(match[1]), int(match[2] or match[1])) if match else (0, 0)
        if not 1 <= low <= high <= most:
            raise StudyError(f"expected numbers from 1 to {most}, found {checks.quoted(word)}")
        chosen |= set(range(low, high + 1))
    return sorted(chosen)


def _named(
    what: str,
    given: Sequence[str],
    offers: Sequence[Offer],
    names: Callable[[Offer], Sequence[str]],
) -> list[Offer]:
    chosen: list[Offer] = []
    for name in given:
        matches = [offer for offer in offers if name in names(offer)]
        if not matches:
            known = dict.fromkeys(n for o in offers for n in names(o))
            # Each offer once: with its node or topic if the name has one.
            alike = [other for other in known if (":" in other) == (":" in name)]
            hint = checks.suggestion(name, alike or known)
            raise StudyError(f"--{what}: there is no {checks.quoted(name)}; {hint}")
        chosen += [offer for offer in matches if offer not in chosen]
    return chosen
