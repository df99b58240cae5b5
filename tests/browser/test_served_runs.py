"""The runs in a folder as a reader sees them: links and points lead to trials."""

import json
import shutil

import pytest
from made_runs import write_certificate
from pages import ServedRuns
from points import press

from bo_tuner.storage.record import read_run

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def served(feed_axis_run, tmp_path_factory):
    """A folder with two runs of the feed axis."""
    folder = tmp_path_factory.mktemp("served") / "runs"
    for name in ("first", "second"):
        shutil.copytree(feed_axis_run, folder / name)
    pages = ServedRuns(folder, "--web-control")
    pages.folder = folder
    yield pages
    pages.end()


@pytest.fixture
def page(chromium, served):
    """Function that opens a page, for which the browser has the token."""
    chromium.open(served.entrance)

    def opened(path, **options):
        chromium.open(served.address + path, **options)

    return opened


@pytest.mark.parametrize(("theme", "width"), [("light", 1280), ("dark", 390)])
@pytest.mark.parametrize(
    "path",
    [
        "runs",
        "runs/first",
        "runs/first/trials/1",
        "runs/first/trials/compared?trial=1&trial=2",
        "compare?run=first&run=second",
    ],
)
def test_axe_finds_nothing(chromium, page, axe, path, theme, width):
    page(path, theme=theme, width=width)
    assert axe(chromium) == []
    assert chromium.evaluate("document.documentElement.scrollWidth") <= width
    assert chromium.errors == []


def test_the_list_follows_without_being_loaded_again(chromium, page, served):
    """A new run appears and a row changes, while what is ticked, typed and focused stays."""
    page("runs")
    row = "document.querySelector('#runs input[value=first]')"
    chromium.evaluate(f"{row}.click(); {row}.focus(); window.same = true")
    names = "[...document.querySelectorAll('#runs tbody a')].map(a => a.textContent)"
    assert "third" not in chromium.evaluate(names)
    shutil.copytree(served.folder / "first", served.folder / "third")
    record = read_run(served.folder / "first")
    write_certificate(record, record.result)
    try:
        chromium.wait_for(f"{names}.includes('third')")
        chromium.wait_for(f"{row}.closest('tr').textContent.includes('PASS')")
        assert chromium.evaluate(f"[{row}.checked, document.activeElement === {row}, same]") == [
            True, True, True,
        ]  # fmt: skip
        assert chromium.evaluate("document.querySelector('#runs caption').textContent") == "3 runs"
    finally:
        shutil.rmtree(served.folder / "third")
        shutil.rmtree(record.path / "certificates")
    chromium.wait_for(f"!{names}.includes('third')")
    # A filter holds for a run that comes later, too.
    chromium.evaluate(
        "(() => { const input = document.querySelector('#runs .filter input');"
        "input.value = 'second'; input.dispatchEvent(new Event('input')); })()"
    )
    shutil.copytree(served.folder / "first", served.folder / "third")
    try:
        chromium.wait_for(f"{names}.includes('third')")
        shown = f"{names.replace('#runs tbody', '#runs tbody tr:not([hidden])')}"
        assert chromium.evaluate(shown) == ["second"]
    finally:
        shutil.rmtree(served.folder / "third")
    assert chromium.errors == []


def test_sliders_count_together_where_the_models_are(chromium, page):
    page("runs/first")
    sliders = "document.querySelector('.what-if')"
    data = chromium.evaluate(f"JSON.parse({sliders}.querySelector('script').textContent)")
    for k in range(2):
        chromium.evaluate(
            f"(() => {{ const input = {sliders}.querySelectorAll('input')[{k}]; input.value = 5;"
            "input.dispatchEvent(new Event('input')); })()"
        )
    cells = f"[...{sliders}.querySelectorAll('tbody td:nth-child(2)')].map(c => c.textContent)"
    same = f"JSON.stringify({cells}) === JSON.stringify"
    for along in data["along"]:
        chromium.wait_for(f"!({same}({json.dumps(along[5]['cells'])}))")
    places = f"[...{sliders}.querySelectorAll('input')].map(i => i.value)"
    assert chromium.evaluate(places) == ["5", "5"]
    values = "&".join(f"{each['name']}={each['values'][5]!r}" for each in data["sliders"])
    asked = f"fetch('/runs/first/forecast?{values}').then(a => a.json())"
    told = chromium.evaluate(asked)
    chromium.wait_for(f"{same}({json.dumps(told['cells'])})")
    assert chromium.errors == []


def test_a_command_is_started_and_ended(chromium, page, axe):
    page("runs/first", width=390)
    assert chromium.evaluate("document.getElementById('started').hidden")
    chromium.evaluate(
        "[...document.querySelectorAll('.steps button.start')]"
        ".find(b => b.parentElement.textContent.startsWith('validate')).click()"
    )
    said = "document.querySelector('#started .output').textContent"
    chromium.wait_for(f"{said}.length > 0")
    state = "document.querySelector('#started .state').textContent"
    assert chromium.evaluate(state) == "Running"
    assert axe(chromium) == []
    assert chromium.evaluate("document.documentElement.scrollWidth") <= 390
    chromium.evaluate("document.querySelector('#started .end').click()")
    chromium.wait_for(f"{state} === 'Ended with exit code 130'")
    # Whoever opens the page later sees the same.
    page("runs/second")
    chromium.wait_for(f"{state} === 'Ended with exit code 130'")
    assert chromium.errors == []


def test_a_row_and_a_point_lead_to_a_trial(chromium, page, served):
    page("runs/second")
    link = "document.querySelector('#all-trials tbody a')"
    assert chromium.evaluate(f"{link}.href") == f"{served.address}runs/second/trials/0"
    press(chromium, "figure-convergence", 1)
    chromium.wait_for("location.pathname === '/runs/second/trials/1'")


def test_a_point_of_a_report_leads_to_its_row(chromium, feed_axis_page):
    chromium.open(feed_axis_page)
    press(chromium, "figure-convergence", 3)
    row = "document.querySelector('#all-trials tr.sought')"
    assert chromium.evaluate(f"Number({row}.cells[0].textContent)") == 3
    # Its table was closed before.
    assert chromium.evaluate(f"{row}.checkVisibility()")
