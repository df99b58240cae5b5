"""A browser, and reports to look at."""

import importlib.util
import json
import sys
from pathlib import Path

import pytest

sys.path.append(str(Path(__file__).parent))


@pytest.fixture(scope="session")
def chromium(tmp_path_factory):
    from chromium import Chromium, find_chromium

    if find_chromium() is None:
        pytest.skip("no Chromium is installed")
    with Chromium(tmp_path_factory.mktemp("profile")) as browser:
        yield browser


@pytest.fixture(scope="session")
def axe():
    """Function that lists the rules of axe-core that an open page breaks, each with its impact."""
    spec = importlib.util.find_spec("axe_core_python")
    if spec is None or spec.origin is None:
        pytest.skip("axe-core-python is not installed")
    script = Path(spec.origin).with_name("axe.min.js").read_text(encoding="utf-8")

    def findings(browser, *, contrast=True):
        browser.evaluate(f"{script}; 0")
        # Without the details of what passes, which take half of the time.
        rules = {"color-contrast": {"enabled": contrast}}
        options = json.dumps({"resultTypes": ["violations"], "rules": rules})
        found = browser.evaluate(
            f"axe.run({options}).then(r => r.violations.map(v => [v.id, v.impact]))"
        )
        return [tuple(item) for item in found]

    return findings


@pytest.fixture(scope="session")
def feed_axis_run(tmp_path_factory):
    from report_runs import feed_axis_study, run_study

    return run_study(tmp_path_factory.mktemp("feed_axis"), feed_axis_study())


@pytest.fixture(scope="session")
def feed_axis_page(feed_axis_run, tmp_path_factory):
    return _page(feed_axis_run, tmp_path_factory)


@pytest.fixture(scope="session")
def harmful_page(tmp_path_factory):
    from report_runs import run_axis, with_ends

    run = run_axis(tmp_path_factory.mktemp("harmful"), **with_ends(0.6))
    return _page(run, tmp_path_factory)


@pytest.fixture(scope="session")
def front_page(tmp_path_factory):
    """A report with a front: of two objectives, each of which has its optimum elsewhere."""
    from report_runs import run_axis

    # The error is smallest at a gain of 0.3, the peak at 0.
    run = run_axis(tmp_path_factory.mktemp("front"), further_objectives=[{"metric": "peak"}])
    return _page(run, tmp_path_factory)


def _page(run, tmp_path_factory):
    from bo_tuner.report.page import write_report
    from bo_tuner.storage.record import read_run

    return write_report(read_run(run), tmp_path_factory.mktemp("page") / "report.html")
