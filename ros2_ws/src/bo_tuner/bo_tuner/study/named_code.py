"""Python code that a study names as ``module:name``."""

import importlib
from typing import Any


def load(path: str) -> Any:
    """Return what ``module:name`` names; raises whatever the import raises."""
    module, _, name = path.partition(":")
    target: Any = importlib.import_module(module)
    for part in name.split("."):
        target = getattr(target, part)
    return target
