"""Objects of a study out of the dictionaries of its file."""

import dataclasses
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any, TypeVar

from bo_tuner.codec import checks
from bo_tuner.errors import StudyError

T = TypeVar("T")


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

    @contextmanager
    def under(self, *keys: str | int) -> Iterator[None]:
        """Keep an error raised inside, with `keys` before its key path."""
        try:
            yield
        except StudyError as error:
            problem = error.under(*keys)
            self._problems += [problem.located(problem.source, problem.line), *problem.others]

    def __len__(self) -> int:
        """How many were found."""
        return len(self._problems)

    def check(self, counts: Callable[[StudyError], bool] = lambda _: True) -> None:
        """Raise the first error that was found and counts, if any, with the others."""
        if problems := [error for error in self._problems if counts(error)]:
            first, *others = problems
            raise first.with_others(others)


def build(cls: type[T], value: object, **given: object) -> T:
    """Build an object from the fields in `value`; those in `given` are not keys of the file."""
    return cls(**arguments(cls, value, skip=tuple(given)), **given)


def arguments(
    cls: type[Any], value: object, skip: Sequence[str] = (), also: Sequence[str] = ()
) -> dict[str, Any]:
    """Return the mapping `value` if its keys are fields of `cls` and none is missing.

    `skip` are fields that are not keys, `also` further keys to suggest for an unknown one. The
    error has all that is wrong with the keys.
    """
    value = checks.mapping(value)
    fields = [field for field in dataclasses.fields(cls) if field.name not in skip]
    names = [field.name for field in fields]
    findings = Findings()
    for key in value:
        with findings.under():
            if not isinstance(key, str):
                raise StudyError(f"expected text as a key, found {checks.show(key)}")
            if key not in names:
                raise StudyError(f"unknown key; {checks.suggestion(key, [*also, *names])}", (key,))
    for field in fields:
        if is_required(field) and field.name not in value:
            # The error on a misspelt key names this field already.
            unknown = [key for key in value.keys() - names if isinstance(key, str)]
            if any(checks.meant(key, [field.name]) for key in unknown):
                continue
            with findings.under():
                raise StudyError("missing", (field.name,))
    findings.check()
    return dict(value)


def is_required(field: "dataclasses.Field[Any]") -> bool:
    """Return whether a field has no default."""
    return field.default is field.default_factory is dataclasses.MISSING
