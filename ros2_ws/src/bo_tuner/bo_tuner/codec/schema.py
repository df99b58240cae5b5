"""Annotated dataclasses as JSON Schema, for editors.

Reference: JSON Schema, draft 2020-12, https://json-schema.org/draft/2020-12.
"""

import inspect
import types
from collections.abc import Mapping
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from bo_tuner.codec.reading import Field, classes_in, keys_of
from bo_tuner.codec.rules import Alone, Schema, Written

SCALARS: dict[object, Schema] = {
    bool: {"type": "boolean"},
    int: {"type": "integer"},
    float: {"type": "number"},
    str: {"type": "string"},
}


class Schemas:
    """The schemas of classes, each by its name, as far as they were asked for.

    Attributes
    ----------
    definitions : dict
        The schemas by the names of the classes.
    """

    def __init__(self) -> None:
        self.definitions: dict[str, Schema] = {}

    def of_object(self, cls: type[Any]) -> Schema:
        """Return the schema of a mapping that describes an object of a class."""
        texts, keys = texts_of(cls), keys_of(cls)
        properties = {}
        for item in keys:
            text = {"description": texts[item.name]} if item.name in texts else {}
            properties[item.name] = self.of_field(item) | text
        schema: Schema = {
            "type": "object",
            "properties": properties,
            "additionalProperties": False,
        }
        if required := [item.name for item in keys if item.is_required]:
            schema["required"] = required
        return schema

    def of_field(self, item: Field) -> Schema:
        """Return the schema of a field of a class."""
        if item.beside is not None:
            return {"enum": list(item.beside.kinds())}
        return self._of(item.hint)

    def reference(self, cls: type[Any]) -> Schema:
        """Return a reference to the schema of a class."""
        name = cls.__name__
        if name not in self.definitions:
            self.definitions[name] = {}
            beside = [item for item in keys_of(cls) if item.beside is not None]
            schema = self.of_object(cls)
            self.definitions[name] = self._with_kinds(schema, beside[0]) if beside else schema
        return {"$ref": f"#/$defs/{name}"}

    def _with_kinds(self, schema: Schema, item: Field) -> Schema:
        """Add the keys of each kind to those beside them: both are on one level."""
        kinds = []
        for kind, cls in (item.beside.kinds() if item.beside is not None else {}).items():
            own = self.of_object(cls)
            properties = schema["properties"] | own["properties"] | {item.name: {"const": kind}}
            required = [*schema["required"], *own.get("required", [])]
            kinds.append({**schema, "properties": properties, "required": required})
        return {"anyOf": kinds}

    def _of(self, hint: Any) -> Schema:
        origin, parts = get_origin(hint), get_args(hint)
        if origin is Annotated:
            return self._of_annotated(parts[0], parts[1:])
        if hint in SCALARS:
            return dict(SCALARS[hint])
        if origin is Literal:
            return {"enum": list(parts)} if len(parts) > 1 else {"const": parts[0]}
        if origin in (Union, types.UnionType):
            kinds = [self._of(part) for part in parts if part is not type(None)]
            return kinds[0] if len(kinds) == 1 else {"anyOf": kinds}
        if origin is tuple and parts[-1] is Ellipsis:
            return {"type": "array", "items": self._of(parts[0])}
        if origin is tuple:
            items = [self._of(part) for part in parts]
            size = {"minItems": len(items), "maxItems": len(items)}
            return {"type": "array", "prefixItems": items, **size}
        if isinstance(origin, type) and issubclass(origin, Mapping):
            return {"type": "object", "additionalProperties": self._of(parts[1])}
        if not classes_in(hint):
            return {}
        alone: Alone | None = getattr(hint, "alone", None)
        reference = self.reference(hint)
        return reference if alone is None else {"anyOf": [reference, self._of(alone.kind)]}

    def _of_annotated(self, kind: Any, rules: tuple[Any, ...]) -> Schema:
        schema = self._of(kind)
        for rule in rules:
            if isinstance(rule, Written):
                return {"anyOf": [schema, self._of(rule.kind)]}
            schema |= getattr(rule, "schema", {})
        return schema


def texts_of(cls: type[Any]) -> dict[str, str]:
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
