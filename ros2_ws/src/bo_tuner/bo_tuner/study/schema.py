"""The study file as a JSON schema, for editors, and as a page of reference.

Both come from the classes that check a study: keys, types and defaults from their fields, the texts
from their docstrings. ``python -m bo_tuner.study.schema SCHEMA PAGE`` writes the two files; a test
holds them against the classes.

Reference: JSON Schema, draft 2020-12, https://json-schema.org/draft/2020-12.
"""

import dataclasses
import inspect
import json
import sys
import types
import typing
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from bo_tuner.study.constraint import Constraint
from bo_tuner.study.distributions import DISTRIBUTIONS
from bo_tuner.study.guarding import Guarding
from bo_tuner.study.limit_kinds.limited import LOWER, UPPER
from bo_tuner.study.metrics import StudyMetric
from bo_tuner.study.nodes import NodeSpec
from bo_tuner.study.parameter import TYPES, Parameter
from bo_tuner.study.parts import ContextVariable
from bo_tuner.study.playing import Answer, Bags, Play
from bo_tuner.study.profiles import Profile
from bo_tuner.study.resting import Rest, WarmUp
from bo_tuner.study.run import End
from bo_tuner.study.safe_search import SafeSearch
from bo_tuner.study.signals import Signal
from bo_tuner.study.study import Study

Schema = dict[str, Any]

DIALECT = "https://json-schema.org/draft/2020-12/schema"
NAMED = {
    "nodes": (NodeSpec,),
    "parameters": (Parameter,),
    "contexts": (ContextVariable,),
    "signals": (Signal,),
    "metrics": typing.get_args(StudyMetric),
    "constraints": (Constraint,),
}
"""Sections of objects by name, with the kinds of these."""
SCALARS: dict[object, Schema] = {
    bool: {"type": "boolean"},
    int: {"type": "integer"},
    float: {"type": "number"},
    str: {"type": "string"},
}
CHOICES: dict[tuple[type, str], tuple[str, ...]] = {
    (Parameter, "type"): TYPES,
    (ContextVariable, "type"): TYPES,
}
WORDS: dict[type, Schema] = {
    End: {"enum": ["result", "played"]},
    Guarding: {"type": "boolean"},
    SafeSearch: {"type": "boolean"},
    WarmUp: {"type": "integer"},
    Rest: {"type": "number"},
}
"""Single words that can stand for a mapping."""


def schema() -> Schema:
    """Return the JSON schema of a study file."""
    definitions: dict[str, Schema] = {}
    root = _object(Study, definitions)
    for key, classes in NAMED.items():
        kinds = [_reference(cls, definitions) for cls in classes]
        items = kinds[0] if len(kinds) == 1 else {"anyOf": kinds}
        root["properties"][key] |= {"type": "object", "additionalProperties": items}
        root["properties"][key].pop("$ref", None)
    return {"$schema": DIALECT, "title": "Study file of bo_tuner", **root, "$defs": definitions}


def page() -> str:
    """Return the page of reference, as Markdown."""
    definitions: dict[str, Schema] = {}
    lines = [
        "# Study file: all keys",
        "",
        "Made by `python -m bo_tuner.study.schema` from the classes that check a study; do not",
        "edit.",
        "What sections mean and how they work together is in [interfaces.md](interfaces.md).",
        "",
        "An editor that knows JSON schemas completes and checks a study file that begins with",
        "",
        "```yaml",
        "# yaml-language-server: $schema=<share/bo_tuner>/config/study.schema.json",
        "name: my_study",
        "```",
    ]
    told: set[tuple[str, str]] = set()
    for title, cls in _sections():
        lines += ["", f"## {title}", "", _introduction(cls), ""]
        texts = _texts(cls)
        rows, again = [], []
        for field in _keys(cls):
            kind = _kind(_field(cls, field, definitions))
            text = texts.get(field.name, "").replace("|", "\\|").replace("``", "`")
            row = f"| `{field.name}` | {kind} | {_default(field)} | {text} |"
            # What several kinds of a section have is told with the first of them.
            if (place := (title.partition(",")[0], row)) in told:
                again.append(f"`{field.name}`")
            else:
                rows.append(row)
                told.add(place)
        if rows:
            lines += ["| key | type | default | meaning |", "|---|---|---|---|", *rows]
        if again:
            lines += [*([""] if rows else []), f"As above: {', '.join(again)}."]
    return "\n".join(lines) + "\n"


def main(arguments: list[str]) -> None:
    """Write schema and page to the two files named."""
    to_schema, to_page = map(Path, arguments)
    to_schema.write_text(json.dumps(schema(), indent=1) + "\n", encoding="utf-8")
    to_page.write_text(page(), encoding="utf-8")


def _sections() -> Iterator[tuple[str, type[Any]]]:
    """Yield the classes of a study file in the order of the page, each once, with its title."""
    yield "The file", Study
    for key, classes in NAMED.items():
        for cls in classes:
            title = f"`{key}: <name>`"
            yield (f"{title}, {cls.__name__}" if len(classes) > 1 else title), cls
        if key == "contexts":
            for kind, cls in DISTRIBUTIONS.items():
                yield f"`contexts: <name>`, `distribution: {kind}`", cls
            yield "`contexts: <name>`, bags", Bags
    named = {cls for classes in NAMED.values() for cls in classes}
    yield from _below(Study, "", named)


def _below(cls: type[Any], path: str, seen: set[type[Any]]) -> Iterator[tuple[str, type[Any]]]:
    hints = typing.get_type_hints(cls)
    for field in _keys(cls):
        for inner in _classes(hints[field.name]):
            if inner not in seen:
                seen.add(inner)
                yield f"`{path}{field.name}`", inner
                yield from _below(inner, f"{path}{field.name}: ", seen)


def _classes(hint: Any) -> list[type[Any]]:
    if dataclasses.is_dataclass(hint) and isinstance(hint, type):
        return [hint]
    return [cls for part in typing.get_args(hint) for cls in _classes(part)]


def _keys(cls: type[Any]) -> list[dataclasses.Field[Any]]:
    named = {item for classes in NAMED.values() for item in classes}
    skipped = {"name"} if cls in named else set()
    return [field for field in dataclasses.fields(cls) if field.name not in skipped]


def _object(cls: type[Any], definitions: dict[str, Schema]) -> Schema:
    texts = _texts(cls)
    properties = {}
    required = []
    for field in _keys(cls):
        of_field = _field(cls, field, definitions)
        if field.name in texts:
            of_field = {**of_field, "description": texts[field.name]}
        properties[field.name] = of_field
        if field.default is field.default_factory is dataclasses.MISSING:
            required.append(field.name)
    result: Schema = {"type": "object", "properties": properties, "additionalProperties": False}
    if cls is Parameter:
        # A running node can be asked for its type.
        required.remove("type")
    if cls is Constraint:
        result["anyOf"] = [{"required": ["upper"]}, {"required": ["lower"]}]
    if required:
        result["required"] = required
    return result


def _field(cls: type[Any], field: dataclasses.Field[Any], definitions: dict[str, Schema]) -> Schema:
    choices = CHOICES.get((cls, field.name))
    if choices is not None:
        return {"enum": list(choices)}
    if cls is ContextVariable and field.name == "distribution":
        return {"enum": list(DISTRIBUTIONS)}
    schema = _type(typing.get_type_hints(cls)[field.name], definitions)
    if (cls, field.name) == (Study, "objective"):
        # A text is a metric, or an expression of metrics, that is minimized.
        return {"anyOf": [schema, {"type": "string"}]}
    if cls is Constraint and field.name in (UPPER, LOWER):
        # A text is a limit relative to the default.
        return {"anyOf": [schema, {"type": "string"}]}
    for part, alone in WORDS.items():
        if schema.get("$ref") == f"#/$defs/{part.__name__}":
            return {"anyOf": [schema, alone]}
    return schema


def _type(hint: Any, definitions: dict[str, Schema]) -> Schema:
    if hint in SCALARS:
        return dict(SCALARS[hint])
    if hint in (Profile, Answer, Play):
        # A text is an expression, a topic, or a bag.
        return {"anyOf": [_reference(hint, definitions), {"type": "string"}]}
    if dataclasses.is_dataclass(hint) and isinstance(hint, type):
        return _reference(hint, definitions)
    origin, parts = typing.get_origin(hint), typing.get_args(hint)
    if origin in (typing.Union, types.UnionType):
        kinds = [_type(part, definitions) for part in parts if part is not type(None)]
        return kinds[0] if len(kinds) == 1 else {"anyOf": kinds}
    if origin is tuple and parts[-1] is Ellipsis:
        return {"type": "array", "items": _type(parts[0], definitions)}
    if origin is tuple:
        items = [_type(part, definitions) for part in parts]
        size = {"minItems": len(items), "maxItems": len(items)}
        return {"type": "array", "prefixItems": items, **size}
    if isinstance(origin, type) and issubclass(origin, Mapping):
        return {"type": "object", "additionalProperties": _type(parts[1], definitions)}
    return {}


def _reference(cls: type[Any], definitions: dict[str, Schema]) -> Schema:
    if cls.__name__ not in definitions:
        definitions[cls.__name__] = {}
        schema = _object(cls, definitions)
        if cls is ContextVariable:
            schema = _with_distributions(schema, definitions)
        definitions[cls.__name__] = schema
    return {"$ref": f"#/$defs/{cls.__name__}"}


def _with_distributions(schema: Schema, definitions: dict[str, Schema]) -> Schema:
    """Add the keys of each distribution to those of a context: both are on one level."""
    kinds = []
    for kind, cls in DISTRIBUTIONS.items():
        own = _object(cls, definitions)
        properties = schema["properties"] | own["properties"] | {"distribution": {"const": kind}}
        required = [*schema["required"], *own.get("required", [])]
        kinds.append({**schema, "properties": properties, "required": required})
    bags = _object(Bags, definitions)
    properties = {k: v for k, v in schema["properties"].items() if k != "distribution"}
    kinds.append({**schema, "properties": properties | bags["properties"], "required": ["bags"]})
    return {"anyOf": kinds}


def _texts(cls: type[Any]) -> dict[str, str]:
    """Return the texts of a class's Attributes section, those of its bases included."""
    texts: dict[str, str] = {}
    for base in reversed(cls.__mro__):
        names: list[str] = []
        inside = False
        lines = (inspect.cleandoc(base.__doc__) if base.__doc__ else "").splitlines()
        for line, following in zip(lines, [*lines[1:], ""], strict=True):
            if set(following) == {"-"}:
                inside, names = line == "Attributes", []
            elif inside and line and not line.startswith((" ", "-")):
                names = [name.strip() for name in line.partition(":")[0].split(",")]
                texts |= dict.fromkeys(names, "")
            elif inside and line:
                for name in names:
                    texts[name] = f"{texts[name]} {line.strip()}".strip()
    return texts


def _introduction(cls: type[Any]) -> str:
    """Return the docstring of a class up to its first section, a paragraph a line."""
    text = inspect.cleandoc(cls.__doc__ or "")
    paragraphs = []
    for paragraph in text.split("\n\n"):
        if paragraph.partition("\n")[2].startswith("---"):
            break
        paragraphs.append(" ".join(paragraph.split()))
    return "\n\n".join(paragraphs)


def _default(field: dataclasses.Field[Any]) -> str:
    if field.default is dataclasses.MISSING:
        return "required" if field.default_factory is dataclasses.MISSING else ""
    value = field.default
    if value is None or value == "" or value != value:
        return ""
    if dataclasses.is_dataclass(value):
        return ""
    return f"`{json.dumps(value)}`"


def _kind(schema: Schema) -> str:
    """Name a type in a word or two."""
    if "$ref" in schema:
        return "mapping"
    if "enum" in schema:
        return ", ".join(f"`{choice}`" for choice in schema["enum"])
    if "const" in schema:
        return f"`{schema['const']}`"
    if "anyOf" in schema:
        kinds = list(dict.fromkeys(_kind(item) for item in schema["anyOf"]))
        # An integer is a number, too.
        return " or ".join(kind for kind in kinds if kind != "integer" or "number" not in kinds)
    if schema.get("type") == "array":
        items = schema.get("items") or schema["prefixItems"][0]
        size = f" of {schema['maxItems']}" if "maxItems" in schema else ""
        return f"list{size}: {_kind(items)}"
    words = {"string": "text", "object": "mapping"}
    return str(words.get(schema.get("type", ""), schema.get("type", "any")))


if __name__ == "__main__":
    main(sys.argv[1:])
