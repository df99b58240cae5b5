"""Dataclasses as JSON, and back."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from math import inf, isnan, nan
from typing import Annotated

import pytest

from bo_tuner.codec.reading import JSON, read
from bo_tuner.codec.rules import Null
from bo_tuner.codec.writing import to_json


class Colour(StrEnum):
    RED = "red"
    BLUE = "blue"


@dataclass(frozen=True)
class Inner:
    bound: Annotated[float, Null(inf)]
    note: str | None = None


@dataclass(frozen=True)
class Outer:
    name: str
    count: int
    share: float
    passed: bool
    colour: Colour
    inner: Inner
    maybe: Inner | None
    items: tuple[Inner, ...]
    values: Mapping[str, bool | int | float | str]


OUTER = Outer(
    "x", 3, 0.5, True, Colour.RED, Inner(inf), None, (Inner(1.0, "é"), Inner(2.0)),
    {"a": True, "b": 1, "c": 1.5, "d": "text"},
)  # fmt: skip


def through_text(value):
    return json.loads(json.dumps(to_json(value), allow_nan=False))


def test_what_was_written_is_read_back():
    found = read(Outer, through_text(OUTER), JSON)
    assert found == OUTER
    # True equals 1, and 1 equals 1.0.
    assert repr(found) == repr(OUTER)


def test_null_is_nan_unless_the_field_says_what_it_stands_for():
    content = through_text(OUTER) | {"share": None}
    found = read(Outer, content, JSON)
    assert isnan(found.share)
    assert found.inner.bound == inf
    assert content["inner"]["bound"] is None


def test_nan_is_written_as_null():
    assert to_json(Outer(**(vars(OUTER) | {"share": nan})))["share"] is None


def test_a_whole_number_is_a_number():
    found = read(Outer, through_text(OUTER) | {"share": 2}, JSON)
    assert (found.share, type(found.share)) == (2.0, float)


def test_further_values_are_left_aside():
    assert read(Outer, through_text(OUTER) | {"more": []}, JSON) == OUTER


@pytest.mark.parametrize(
    ("place", "value", "complaint"),
    [
        (["name"], 1, "name: expected text, found 1"),
        (["name"], None, "name: expected text, found nothing"),
        (["name"], "\ud800", "name: expected text in Unicode, found text"),
        (["count"], 1.0, "count: expected an integer, found 1.0"),
        (["count"], True, "count: expected an integer, found true"),
        (["count"], 10**30, "count: expected a 64-bit integer, found an integer beyond 64 bits"),
        (["share"], "0.5", "share: expected a number, found text '0.5'"),
        (["share"], True, "share: expected a number, found true"),
        (["share"], inf, "share: expected a finite number, found inf"),
        (["share"], 10**400, "share: expected a 64-bit integer, found an integer beyond 64 bits"),
        (["passed"], 1, "passed: expected true or false, found 1"),
        (["colour"], "green", "colour: unknown 'green'; expected one of red, blue"),
        (["inner"], [], "inner: expected a mapping, found a list of 0"),
        (["inner"], {}, "inner.bound: missing"),
        (["maybe"], {"bound": "x", "note": None}, "maybe.bound: expected a number, found text 'x'"),
        (["items"], {}, "items: expected a list, found a mapping"),
        (["items", 1, "note"], 7, r"items\[1\].note: expected text, found 7"),
        (["values"], [], "values: expected a mapping, found a list of 0"),
        (["values", "b"], None, "values.b: expected a number, text, true or false, found nothing"),
        (["values", "c"], nan, "values.c: expected a finite number, found nan"),
    ],
)
def test_anything_else_is_refused_with_its_place(place, value, complaint):
    content = through_text(OUTER)
    *path, last = place
    inside = content
    for key in path:
        inside = inside[key]
    inside[last] = value
    with pytest.raises(ValueError, match=f"^{complaint}"):
        read(Outer, content, JSON)


@pytest.mark.parametrize("content", [None, [], 1, "x"])
def test_what_is_no_object_is_refused(content):
    with pytest.raises(ValueError, match=r"^expected a mapping, found"):
        read(Outer, content, JSON)
