"""Fixtures of the tuner's tests: studies of plain functions, and a backend for them."""

from functions import (  # noqa: F401  (fixtures)
    _failed,
    _function_backend,
    _make_study,
    _make_trial,
)
