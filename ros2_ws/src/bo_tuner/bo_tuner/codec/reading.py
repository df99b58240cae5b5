"""Plain data, as a YAML or JSON file has it, read into objects by their annotations.

A frozen dataclass says by its annotations what its fields are: numbers, texts, truth values,
enumerations of text, tuples, mappings from text, other dataclasses, each or None, and by the rules
of `bo_tuner.codec.rules` what is asked of them beside their type. A `Section` asks this of itself
whenever it is made, from a file or in Python.
"""

import dataclasses
import types
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from functools import cache, partial
from typing import (
    Annotated,
    Any,
    ClassVar,
    Literal,
    TypeVar,
    Union,
    get_args,
    get_origin,
    get_type_hints,
)

from bo_tuner.codec import checks
from bo_tuner.codec.findings import Findings
from bo_tuner.codec.rules import KEY, LATER, Alone, Beside, Chosen, Expected, Null
from bo_tuner.errors import StudyError

T = TypeVar("T")

TRUTH = "true or false"

Read = Callable[[Any, str], Any]
"""From a plain value, and the name of the entry that it is, to the value of an annotation."""


@dataclass(frozen=True)
class Form:
    """How a file is read.

    Attributes
    ----------
    null
        What null stands for where a number is expected; None if it is none.
    has_more
        Whether keys that are no fields are left aside, and not refused.
    """

    null: float | None = None
    has_more: bool = False


STUDY = Form()
JSON = Form(null=float("nan"), has_more=True)


def read(hint: Any, value: object, form: Form = STUDY, name: str = "") -> Any:
    """Return what a plain value is by an annotation; `name` is that of the entry that it is.

    Raises
    ------
    StudyError
        If it is no such value: with the places of all that is wrong, what was expected and found.
    """
    return _reader(hint, form)(value, name)


def entries(hint: Any, value: object, findings: Findings) -> dict[str, Any]:
    """Return the entries of a mapping by name; what is wrong with others goes to `findings`."""
    items: dict[str, Any] = {}
    with findings.under():
        for name, item in read(Annotated[Mapping[str, object], *hint.__metadata__], value).items():
            with findings.under(name):
                items[name] = read(get_args(get_args(hint)[0])[1], item, name=name)
    return items


def classes_in(hint: Any) -> list[type[Any]]:
    """Return the dataclasses that an annotation names."""
    if dataclasses.is_dataclass(hint) and isinstance(hint, type):
        return [hint]
    return [cls for part in get_args(hint) for cls in classes_in(part)]


class Section:
    """Base of frozen dataclasses that check their fields by their annotations."""

    alone: ClassVar[Alone | None] = None
    """What may stand in a file in place of its mapping."""

    def __post_init__(self) -> None:
        """Check the fields; derived classes check what is between these."""
        findings = Findings()
        check_fields(self, findings)
        findings.check()


def check_fields(section: Any, findings: Findings) -> None:
    """Settle the fields of a frozen dataclass; a wrong one gets its default, if it has one."""
    cls: Any = type(section)
    for item in fields_of(cls):
        given = getattr(section, item.name)
        if item.is_default(given):
            continue
        try:
            value = item.read(given, "")
        except StudyError as error:
            findings.add(error if item.is_key else error.under(item.name))
            if item.is_required:
                continue
            value = item.default
        if value is not given:
            object.__setattr__(section, item.name, value)


@dataclass(frozen=True)
class Field:
    """A field of a dataclass, with what reads it."""

    name: str
    hint: Any
    field: "dataclasses.Field[Any]"
    read: Read

    @property
    def is_key(self) -> bool:
        """Whether it is no key of a file, but the name of the entry."""
        return KEY in getattr(self.hint, "__metadata__", ())

    @property
    def is_required(self) -> bool:
        """Whether it has no default."""
        return self.field.default is self.field.default_factory is dataclasses.MISSING

    @property
    def default(self) -> Any:
        """Its default, if it has one."""
        if self.field.default_factory is not dataclasses.MISSING:
            return self.field.default_factory()
        return self.field.default

    @property
    def beside(self) -> Beside | None:
        """The kinds of its objects, if their keys stand beside it."""
        found = (rule for rule in getattr(self.hint, "__metadata__", ()) if type(rule) is Beside)
        return next(found, None)

    def is_default(self, value: object) -> bool:
        """Return whether a value is its default, which is taken as it is."""
        default = self.field.default
        return value is default or (type(value) is type(default) and value == default)


@cache
def fields_of(cls: Any, form: Form = STUDY) -> tuple[Field, ...]:
    """Return the fields of a dataclass, its own ones ahead of those of its bases."""
    hints = get_type_hints(cls, include_extras=True)
    own = vars(cls).get("__annotations__", {})
    return tuple(
        Field(item.name, hints[item.name], item, _reader(hints[item.name], form))
        for item in sorted(dataclasses.fields(cls), key=lambda item: item.name not in own)
    )


def keys_of(cls: Any) -> list[Field]:
    """Return the fields of a dataclass that are keys of a file."""
    return [item for item in fields_of(cls) if not item.is_key]


def arguments(
    cls: type[Any],
    value: object,
    skip: Sequence[str] = (),
    also: Sequence[str] = (),
    *,
    has_more: bool = False,
) -> dict[str, Any]:
    """Return the mapping `value` if its keys are fields of `cls` and none is missing.

    `skip` are fields that are not keys, `also` further keys to suggest for an unknown one; with
    `has_more` unknown ones are left aside. The error has all that is wrong with the keys.
    """
    value = checks.mapping(value)
    fields = [field for field in keys_of(cls) if field.name not in skip]
    names = [field.name for field in fields]
    if has_more:
        value = {name: value[name] for name in names if name in value}
    findings = Findings()
    for key in value:
        if not isinstance(key, str):
            findings.add(StudyError(f"expected text as a key, found {checks.show(key)}"))
        elif key not in names:
            suggestion = checks.suggestion(key, [*also, *names])
            findings.add(StudyError(f"unknown key; {suggestion}", (key,)))
    for field in fields:
        if field.is_required and field.name not in value:
            # The error on a misspelt key names this field already.
            unknown = [key for key in value.keys() - names if isinstance(key, str)]
            if not any(checks.meant(key, [field.name]) for key in unknown):
                findings.add(StudyError("missing", (field.name,)))
    findings.check()
    return dict(value)


def _object(cls: Any, form: Form, value: Any, name: str) -> Any:
    """Return the object that a mapping describes; `name` is that of the entry."""
    if isinstance(value, cls):
        return value
    alone: Alone | None = getattr(cls, "alone", None)
    if alone is not None and not isinstance(value, Mapping):
        value = _written_out(alone, value)
        if value is None:
            return None
    given = {item.name: name for item in fields_of(cls) if item.is_key}
    for item in keys_of(cls):
        if (beside := item.beside) is not None:
            value, given[item.name] = _apart(cls, item.name, beside.kinds(), value)
    values = arguments(cls, value, tuple(given), has_more=form.has_more)
    if not issubclass(cls, Section):
        readers = {item.name: item.read for item in fields_of(cls, form)}
        values = _each((key, readers[key], item) for key, item in values.items())
    return cls(**values, **given)


def _written_out(alone: Alone, value: object) -> Mapping[str, object] | None:
    """Return the mapping that a value is short for."""
    if takes(alone.kind, value):
        return alone.fields(value)
    words = [word for word in get_args(alone.kind) if isinstance(value, str)]
    found = checks.meant(str(value), words) or f"found {checks.show(value)}"
    raise StudyError(f"expected {alone.expected}; {found}")


def _apart(
    cls: type[Any], key: str, kinds: Mapping[str, type[Any]], value: object
) -> tuple[Mapping[str, object], Any]:
    """Return the keys of a class itself, and the object whose keys stand beside them."""
    value = checks.mapping(value)
    if key not in value:
        raise StudyError(f"missing; expected one of {', '.join(kinds)}", (key,))
    kind = kinds[checks.choice(value[key], tuple(kinds), key)]
    own = [item.name for item in keys_of(cls)]
    further = {name: item for name, item in value.items() if name not in own}
    made = kind(**arguments(kind, further, also=own))
    return {name: item for name, item in value.items() if name in own and name != key}, made


def _each(items: Iterable[tuple[Any, Read, Any]]) -> dict[Any, Any]:
    """Return values by their keys, read by a reader each; the error has all that is wrong."""
    findings, values = Findings(), {}
    for key, read_item, item in items:
        try:
            values[key] = read_item(item, key if isinstance(key, str) else "")
        except StudyError as error:
            findings.add(error.under(key))
    findings.check()
    return values


@cache
def _reader(hint: Any, form: Form, expected: str = "") -> Read:
    """Return what reads a value by an annotation; `expected` says what in its own words."""
    origin, parts = get_origin(hint), get_args(hint)
    if origin is Annotated:
        return _annotated(parts[0], hint.__metadata__, form)
    if origin in (Union, types.UnionType):
        return _union(parts, form, expected)
    if origin is tuple:
        size = "" if parts[-1] is Ellipsis else f" of {len(parts)}"
        return partial(_tuple, parts, form, expected or f"a list{size}")
    if isinstance(origin, type) and issubclass(origin, Mapping):
        return partial(_mapping, _reader(parts[1], form), expected or "a mapping")
    if dataclasses.is_dataclass(hint):
        return partial(_object, hint, form)
    if isinstance(hint, type) and issubclass(hint, StrEnum):
        return lambda value, _: hint(checks.choice(value, list(hint)))
    if hint is float and form.null is not None:
        return partial(_number, form.null)
    check = _SCALARS.get(hint)
    return (lambda value, _: value) if check is None else (lambda value, _: check(value))


_SCALARS: dict[Any, Callable[[object], Any]] = {
    bool: checks.boolean,
    int: checks.integer,
    float: checks.number,
    str: checks.text,
}


def _annotated(kind: Any, metadata: tuple[Any, ...], form: Form) -> Read:
    if LATER in metadata:
        return lambda value, _: value
    rules: list[Callable[[Any], Any]] = []
    expected = ""
    for item in metadata:
        if isinstance(item, Chosen):
            return lambda value, name: (
                value if isinstance(value, kind) else _object(item.kind(value), form, value, name)
            )
        if isinstance(item, Null):
            return partial(_number, item.number)
        if isinstance(item, Expected):
            expected = item.words
        elif callable(item):
            rules.append(item)
    # A rule of a number or a text checks its type, too.
    first = None if rules and kind in _SCALARS else _reader(kind, form, expected)

    def read_by_rules(value: Any, name: str) -> Any:
        value = value if first is None else first(value, name)
        for rule in rules:
            value = rule(value)
        return value

    return read_by_rules


def _union(parts: tuple[Any, ...], form: Form, expected: str) -> Read:
    kinds = [(part, _reader(part, form, expected)) for part in parts if part is not type(None)]
    nullable = len(kinds) < len(parts)
    named = dict.fromkeys(_words(part) for part, _ in kinds)
    words = expected or ", ".join(sorted(named, key=lambda word: word == TRUTH))

    def read_one(value: Any, name: str) -> Any:
        if value is None and nullable:
            return None
        for kind, read_kind in kinds:
            if len(kinds) == 1 or takes(kind, value):
                return read_kind(value, name)
        raise StudyError(f"expected {words}, found {checks.show(value)}")

    return read_one


def _tuple(parts: tuple[Any, ...], form: Form, expected: str, value: Any, _: str) -> Any:
    items = checks.sequence(value, expected)
    if parts[-1] is Ellipsis:
        parts = (parts[0],) * len(items)
    elif len(items) != len(parts):
        raise StudyError(f"expected {expected}, found {checks.show(value)}")
    each = enumerate(zip(parts, items, strict=True))
    return tuple(_each((i, _reader(part, form), item) for i, (part, item) in each).values())


def _mapping(read_item: Read, expected: str, value: Any, _: str) -> dict[str, Any]:
    if not isinstance(value, Mapping):
        raise StudyError(f"expected {expected}, found {checks.show(value)}")
    for key in value:
        if not isinstance(key, str):
            raise StudyError(f"expected a name, found {checks.show(key)}")
        checks.text(key)
    return _each((key, read_item, item) for key, item in value.items())


def _number(null: float, value: Any, _: str) -> float:
    return null if value is None else checks.number(value)


def takes(hint: Any, value: object) -> bool:
    """Return whether a value has the shape of an annotation; what is inside is not looked at."""
    origin = get_origin(hint)
    if origin is Annotated:
        return takes(get_args(hint)[0], value)
    if origin is Literal:
        return value in get_args(hint)
    if origin is tuple:
        return isinstance(value, list | tuple)
    if origin is not None or dataclasses.is_dataclass(hint):
        return isinstance(value, Mapping) or (origin is None and isinstance(value, hint))
    if isinstance(value, bool):
        return hint is bool
    return isinstance(value, (int, float) if hint is float else hint)


def _words(hint: Any) -> str:
    """Name what an annotation takes."""
    origin = get_origin(hint)
    if origin is Annotated:
        return _words(get_args(hint)[0])
    if origin is tuple:
        return "a list"
    names = {bool: TRUTH, int: "a number", float: "a number", str: "text"}
    return names.get(hint, "a mapping")
