"""Errors with their places, also several of them together."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from bo_tuner.errors import StudyError


@contextmanager
def under(*keys: str | int) -> Iterator[None]:
    """Prefix the key path of an error raised inside with `keys`."""
    try:
        yield
    except StudyError as error:
        raise error.under(*keys) from None


class Findings:
    """Collects errors of parts that are checked one after the other, to report them together."""

    def __init__(self) -> None:
        self._problems: list[StudyError] = []

    def add(self, problem: StudyError) -> None:
        """Keep an error and those that it comes with."""
        self._problems += [problem.located(problem.source, problem.line), *problem.others]

    @contextmanager
    def under(self, *keys: str | int) -> Iterator[None]:
        """Keep an error raised inside, with `keys` before its key path."""
        try:
            yield
        except StudyError as error:
            self.add(error.under(*keys))

    def __len__(self) -> int:
        """How many were found."""
        return len(self._problems)

    def check(self, counts: Callable[[StudyError], bool] = lambda _: True) -> None:
        """Raise the first error that was found and counts, if any, with the others."""
        if problems := [error for error in self._problems if counts(error)]:
            first, *others = problems
            raise first.with_others(others)
