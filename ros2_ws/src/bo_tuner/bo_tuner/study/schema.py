"""The study file as a JSON schema, for editors, and as a page of reference.

Both come from the classes that check a study: keys, types and defaults from their fields, the texts
from their docstrings. ``python -m bo_tuner.study.schema SCHEMA PAGE`` writes the two files; a test
holds them against the classes.

Reference: JSON Schema, draft 2020-12, https://json-schema.org/draft/2020-12.
"""

import inspect
import json
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any, get_args

from bo_tuner.codec.reading import Field, classes_in, keys_of
from bo_tuner.codec.rules import Schema
from bo_tuner.codec.schema import Schemas, texts_of
from bo_tuner.study.distributions import DISTRIBUTIONS
from bo_tuner.study.parts import ContextVariable
from bo_tuner.study.playing import Bags
from bo_tuner.study.study import BY_NAME, Study

DIALECT = "https://json-schema.org/draft/2020-12/schema"


def schema() -> Schema:
    """Return the JSON schema of a study file."""
    schemas = Schemas()
    root = schemas.of_object(Study)
    # A running node can be asked for its type.
    schemas.definitions["Parameter"]["required"].remove("type")
    limits = [{"required": ["upper"]}, {"required": ["lower"]}]
    schemas.definitions["Constraint"]["anyOf"] = limits
    kinds = schemas.definitions["ContextVariable"]["anyOf"]
    kinds.append(_with_bags(kinds[0], schemas.of_object(Bags)))
    title = "Study file of bo_tuner"
    return {"$schema": DIALECT, "title": title, **root, "$defs": schemas.definitions}


def _with_bags(context: Schema, bags: Schema) -> Schema:
    """Return the schema of a context of bags, which stand in place of its distribution."""
    own = [item.name for item in keys_of(ContextVariable) if item.beside is None]
    properties = {name: context["properties"][name] for name in own} | bags["properties"]
    return {**context, "properties": properties, "required": ["bags"]}


def page() -> str:
    """Return the page of reference, as Markdown."""
    schemas = Schemas()
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
        texts = texts_of(cls)
        rows, again = [], []
        for field in keys_of(cls):
            kind = _kind(schemas.of_field(field))
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
    seen: set[type[Any]] = set()
    for item in keys_of(Study):
        if BY_NAME not in get_args(item.hint):
            continue
        classes = classes_in(item.hint)
        seen |= {*classes}
        for cls in classes:
            title = f"`{item.name}: <name>`"
            yield (f"{title}, {cls.__name__}" if len(classes) > 1 else title), cls
        if item.name == "contexts":
            for kind, cls in DISTRIBUTIONS.items():
                yield f"`contexts: <name>`, `distribution: {kind}`", cls
            yield "`contexts: <name>`, bags", Bags
    yield from _below(Study, "", seen)


def _below(cls: type[Any], path: str, seen: set[type[Any]]) -> Iterator[tuple[str, type[Any]]]:
    for item in keys_of(cls):
        for inner in classes_in(item.hint):
            if inner not in seen:
                seen.add(inner)
                yield f"`{path}{item.name}`", inner
                yield from _below(inner, f"{path}{item.name}: ", seen)


def _introduction(cls: type[Any]) -> str:
    """Return the docstring of a class up to its first section, a paragraph a line."""
    text = inspect.cleandoc(cls.__doc__ or "")
    paragraphs = []
    for paragraph in text.split("\n\n"):
        if paragraph.partition("\n")[2].startswith("---"):
            break
        paragraphs.append(" ".join(paragraph.split()))
    return "\n\n".join(paragraphs)


def _default(item: Field) -> str:
    if item.is_required:
        return "required"
    value = item.field.default
    if value is None or value == "" or not isinstance(value, (str, int, float, tuple)):
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
        size = f" of {schema['minItems']}" if "minItems" in schema else ""
        return f"list{size}: {_kind(items)}"
    words = {"string": "text", "object": "mapping"}
    return str(words.get(schema.get("type", ""), schema.get("type", "any")))


if __name__ == "__main__":
    main(sys.argv[1:])
