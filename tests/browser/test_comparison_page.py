"""The page that compares runs, in the themes and widths of a reader."""

import pytest

from bo_tuner.report.analysis import Analysis
from bo_tuner.report.comparison import comparison
from bo_tuner.report.page import write_comparison
from bo_tuner.storage.record import read_run

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def page(feed_axis_run, tmp_path_factory):
    runs = {name: Analysis(read_run(feed_axis_run)) for name in ("first run", "second run")}
    path = tmp_path_factory.mktemp("compared") / "comparison.html"
    return write_comparison("2 runs side by side", comparison(runs), path)


@pytest.mark.parametrize(("theme", "width"), [("light", 1280), ("dark", 390)])
def test_axe_finds_nothing(chromium, page, axe, theme, width):
    chromium.open(page, theme=theme, width=width)
    assert axe(chromium) == []
    assert chromium.evaluate("document.documentElement.scrollWidth") <= width
    assert chromium.errors == []
