"""Judges and optimizers, which an experiment file names by ``module:Class``."""

from typing import Any

from bo_tuner.errors import StudyError
from bo_tuner.study import named_code


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
    try:
        return named_code.load(name)
    except Exception as error:  # Foreign code, which may raise anything.
        problem = " ".join(f"{type(error).__name__}: {error}".split())
        raise StudyError(f"cannot load {name}: {problem}", path) from error
