"""Analysis of a small run; see tests/browser for how the pages look."""

import pytest

from bo_tuner.report.analysis import Analysis


@pytest.fixture(scope="session")
def analysis(tuned):
    return Analysis(tuned)


@pytest.fixture
def importable(tuned, monkeypatch):
    """Lets the study's objects be imported."""
    monkeypatch.syspath_prepend(str(tuned.path.parents[1]))
