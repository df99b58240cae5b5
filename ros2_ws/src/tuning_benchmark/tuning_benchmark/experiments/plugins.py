"""Judges and optimizers, which an experiment file names by ``module:Class``."""

import importlib
from typing import Any

from bo_tuner.errors import KeyPath, StudyError


def load(name: str, *path: str | int) -> Any:
    """Import the class that ``module:Class`` names.

    Parameters
    ----------
    name
        The name.
    *path
        Where it stands in the experiment file, for the error.

    Raises
    ------
    StudyError
        If it cannot be imported; one line.
    """
    module, _, attribute = name.partition(":")
    where: KeyPath = path
    try:
        target: Any = importlib.import_module(module)
        for part in attribute.split("."):
            target = getattr(target, part)
    except Exception as error:  # Foreign code, which may raise anything.
        problem = " ".join(f"{type(error).__name__}: {error}".split())
        raise StudyError(f"cannot load {name}: {problem}", where) from error
    return target
