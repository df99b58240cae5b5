"""Robust tuning of controllers by Bayesian optimization, with worst cases and certificates.

What `__all__` names is the interface for Python programs; ``docs/python.md`` introduces it. All
else is private, and may change with any version. Nothing is loaded until it is used.
"""

import importlib
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from bo_tuner.api.certifying import certify
    from bo_tuner.api.earlier import EarlierRun
    from bo_tuner.api.entries import Boolean, Chance, Choice, Double, Integer, WorstCase
    from bo_tuner.api.result import Result, load
    from bo_tuner.api.study import Study
    from bo_tuner.api.tuner import Run, Tuner
    from bo_tuner.errors import (
        BackendError,
        BoTunerError,
        Failed,
        FunctionError,
        JournalError,
        MetricsError,
        MissingPackageError,
        OutputError,
        RunError,
        RunRecordError,
        StudyError,
        UnknownRunError,
        WindowFull,
    )
    from bo_tuner.study.budget import Budget, CertificateRequirement
    from bo_tuner.study.distributions import (
        Beta,
        Discrete,
        Triangular,
        TruncatedNormal,
        Uniform,
    )
    from bo_tuner.study.parts import Objective

_WHERE = {
    "api.certifying": ["certify"],
    "api.earlier": ["EarlierRun"],
    "api.entries": ["Boolean", "Chance", "Choice", "Double", "Integer", "WorstCase"],
    "api.result": ["Result", "load"],
    "api.study": ["Study"],
    "api.tuner": ["Run", "Tuner"],
    "errors": [
        "BackendError", "BoTunerError", "Failed", "FunctionError", "JournalError", "MetricsError",
        "MissingPackageError", "OutputError", "RunError", "RunRecordError", "StudyError",
        "UnknownRunError", "WindowFull",
    ],
    "study.budget": ["Budget", "CertificateRequirement"],
    "study.distributions": ["Beta", "Discrete", "Triangular", "TruncatedNormal", "Uniform"],
    "study.parts": ["Objective"],
}  # fmt: skip
_MODULES = {name: f"{__name__}.{module}" for module, names in _WHERE.items() for name in names}

__all__ = [
    "BackendError", "Beta", "BoTunerError", "Boolean", "Budget", "CertificateRequirement", "Chance",
    "Choice", "Discrete", "Double", "EarlierRun", "Failed", "FunctionError", "Integer",
    "JournalError", "MetricsError", "MissingPackageError", "Objective", "OutputError", "Result",
    "Run", "RunError", "RunRecordError", "Study", "StudyError", "Triangular", "TruncatedNormal",
    "Tuner", "Uniform", "UnknownRunError", "WindowFull", "WorstCase", "certify", "load",
]  # fmt: skip


def __getattr__(name: str) -> object:
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    found: object = getattr(importlib.import_module(_MODULES[name]), name)
    globals()[name] = found
    return found


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
