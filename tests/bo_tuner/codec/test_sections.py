"""A section of a file by its annotations: read, checked, written and described."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, Literal

import jsonschema
import pytest

from bo_tuner.codec.findings import Findings
from bo_tuner.codec.reading import Section, entries, read
from bo_tuner.codec.rules import (
    KEY,
    Alone,
    AtMost,
    Beside,
    Chosen,
    Expected,
    OneOf,
    Whole,
    Within,
)
from bo_tuner.codec.schema import Schemas
from bo_tuner.codec.writing import changes, to_file
from bo_tuner.errors import StudyError


@dataclass(frozen=True, kw_only=True)
class Circle(Section):
    radius: Annotated[float, Within(above=0.0, most=9.0, unit="m")]


@dataclass(frozen=True, kw_only=True)
class Square(Section):
    side: float = 1.0


SHAPES = {"circle": Circle, "square": Square}


@dataclass(frozen=True, kw_only=True)
class Rest(Section):
    time: float
    mode: Annotated[str, OneOf(("still", "slow"))] = "still"

    alone = Alone(Literal["none"], lambda _: None, "none, or a mapping")


@dataclass(frozen=True, kw_only=True)
class Part(Section):
    name: Annotated[str, KEY]
    shape: Annotated[Section, Beside(lambda: SHAPES)]
    weight: float | None = None


@dataclass(frozen=True, kw_only=True)
class Machine(Section):
    count: Annotated[int, Whole(1, 5)] = 3
    names: Annotated[tuple[str, ...], Expected("a list of names"), AtMost(2)] = ()
    pair: tuple[float, int] | None = None
    rest: Rest | None = None
    parts: Mapping[str, Part] = field(default_factory=dict)
    either: Annotated[
        Circle | Square | None,
        Chosen(lambda keys: Circle if "radius" in dict(keys) else Square),  # type: ignore[call-overload]
    ] = None
    value: bool | int | float | str = ""


def said(**content):
    with pytest.raises(StudyError) as caught:
        read(Machine, content)
    return [str(error) for error in (caught.value, *caught.value.others)]


CONTENT = {
    "count": 2,
    "names": ["a", "b"],
    "pair": [1.5, 2],
    "rest": {"time": 2.0, "mode": "slow"},
    "parts": {"one": {"shape": "circle", "radius": 2.0}, "two": {"shape": "square", "side": 3.0}},
    "either": {"radius": 1.0},
    "value": True,
}


def test_what_is_read_is_written_back():
    whole = read(Machine, CONTENT)
    assert whole.parts["one"] == Part(name="one", shape=Circle(radius=2.0))
    assert type(whole.either) is Circle
    assert to_file(whole) == CONTENT
    jsonschema.validate(CONTENT, schema())


def test_in_python_it_is_the_same():
    """A section that is made in Python is checked, and takes plain data as well."""
    whole = Machine(**CONTENT)
    assert whole == read(Machine, CONTENT)
    assert Machine(pair=(1, 2)).pair == (1.0, 2)


def test_what_stands_for_a_mapping():
    assert read(Machine, {"rest": "none"}).rest is None
    assert said(rest="non") == ["rest: expected none, or a mapping; did you mean 'none'?"]
    assert said(rest=[1]) == ["rest: expected none, or a mapping; found a list of 1"]


def test_all_that_is_wrong_has_its_place():
    wrong = {"count": 6, "names": ["a", 3, None], "parts": {"x": {"shape": "circle"}}, "nmes": 1}
    assert said(**wrong) == ["nmes: unknown key; did you mean 'names'?"]
    del wrong["nmes"]
    assert said(**wrong) == [
        "count: expected an integer of at most 5, found 6",
        "names[1]: expected text, found 3",
        "names[2]: expected text, found nothing",
        "parts.x.radius: missing",
    ]


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ({"names": "a"}, "names: expected a list of names, found text 'a'"),
        ({"names": ["a"] * 3}, "names: expected at most 2 entries, found 3"),
        ({"pair": [1]}, "pair: expected a list of 2, found a list of 1"),
        ({"value": [1]}, "value: expected a number, text, true or false, found a list of 1"),
        ({"parts": {"x": {}}}, "parts.x.shape: missing; expected one of circle, square"),
        ({"parts": {"x": {"shape": "cone"}}}, "parts.x.shape: unknown 'cone'; expected one of"),
        ({"parts": {"x": {"shape": "square", "radius": 1}}}, "parts.x.radius: unknown key"),
        ({"parts": {1: {}}}, "parts: expected a name, found 1"),
        ({"rest": {"time": 1, "mode": "fast"}}, "rest.mode: unknown 'fast'; expected one of "),
        (
            {"either": {"radius": 10}},
            "either.radius: expected a number above 0 and at most 9 m, found 10",
        ),
    ],
)
def test_mistakes(content, message):
    """An editor shows them, too."""
    (found,) = said(**content)
    assert found.startswith(message)
    assert not jsonschema.Draft202012Validator(schema()).is_valid(content)


def test_entries_that_are_right_are_kept_beside_others():
    findings = Findings()
    hint = Annotated[Mapping[str, Part], Expected("parts")]
    content = {"a": {"shape": "square"}, "b": {"shape": "square", "side": "x"}}
    assert entries(hint, content, findings) == {"a": Part(name="a", shape=Square())}
    with pytest.raises(StudyError, match=r"^b\.side: expected a number"):
        findings.check()


def test_changes_are_the_fields_that_are_no_defaults():
    assert changes(Machine(count=2, value="")) == {"count": 2}


def schema():
    schemas = Schemas()
    root = schemas.of_object(Machine)
    return root | {"$defs": schemas.definitions}
