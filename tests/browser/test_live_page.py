"""The page of a run in progress as a reader sees it: it goes on by itself."""

import pytest
from axis import write_study
from commands import Fork
from functions import NODE
from live_run import Page, Run
from report_runs import axis_study
from waiting import wait_until

from bo_tuner.plans import EventKind
from bo_tuner.storage.journal_reader import read_journal
from bo_tuner.study.study_file import study_from_mapping

pytestmark = pytest.mark.slow

TRIALS = "document.querySelectorAll('#trials tbody tr').length"
UNCUT = """[...document.querySelectorAll('#asked, #asked .scroll, .best')]
    .every(part => part.scrollWidth <= part.clientWidth)"""
"""Whether every number of a question is within its card."""


NODES = {"axis": NODE | {"result": "~/cut_result", "object": "report_objects:Axis"}}
STUDY = study_from_mapping(axis_study(nodes=NODES))


def held_run(folder):
    """A run of a small object with a page, held at its 21st evaluation."""
    return Run(folder, STUDY, 21, "--web-control")


@pytest.fixture
def run(tmp_path):
    held = held_run(tmp_path)
    yield held
    held.end()


@pytest.fixture(scope="module")
def shown_run(tmp_path_factory):
    """A run for the tests that only look at it."""
    held = held_run(tmp_path_factory.mktemp("live"))
    yield held
    held.end()


def test_it_follows_the_run(chromium, run):
    chromium.open(run.entrance)
    # The token is in no address that the browser keeps.
    assert chromium.evaluate("location.href") == run.address
    chromium.wait_for(f"{TRIALS} > 0")
    before = chromium.evaluate(TRIALS)
    assert 0 < before < 7
    chromium.evaluate("window.stays = 1")
    assert chromium.evaluate("document.querySelector('.links a').pathname") == f"/runs/{run.name}"

    run.go_on()
    chromium.wait_for("!document.querySelector('#answer').hidden")
    chromium.wait_for(f"{TRIALS} === 7")
    # The same page, the latest trial at the top.
    assert chromium.evaluate("window.stays") == 1
    first = chromium.evaluate("document.querySelector('#trials tbody tr').cells[0].textContent")
    assert first.strip() == "6"
    chromium.wait_for("document.querySelector('#state').textContent.startsWith('Ended. ')")
    assert chromium.evaluate("'harmed' in window") is False
    assert [url for url in chromium.requests if not url.startswith((run.address, "data:"))] == []
    # Only that the server is gone may be said.
    assert [error for error in chromium.errors if "ERR_" not in error] == []


def test_a_trial_has_a_page(chromium, shown_run):
    chromium.open(shown_run.entrance)
    chromium.wait_for("document.querySelector('#trials tbody a') !== null")
    # The latest one is at the top.
    link = chromium.evaluate("[...document.querySelectorAll('#trials tbody a')].at(-1).href")
    assert link == f"{shown_run.address}runs/{shown_run.name}/trials/0"
    chromium.open(link)
    assert chromium.evaluate("document.querySelector('h1').textContent").endswith("trial 0")
    assert chromium.evaluate("document.querySelectorAll('#test-runs tbody tr').length") > 1
    assert chromium.evaluate("'harmed' in window") is False
    assert chromium.errors == []


@pytest.mark.parametrize(("theme", "width"), [("light", 1280), ("dark", 390)])
def test_axe_finds_nothing(chromium, shown_run, axe, theme, width):
    chromium.open(shown_run.entrance, theme=theme, width=width)
    chromium.wait_for(f"{TRIALS} > 0")
    assert axe(chromium) == []
    assert chromium.evaluate("document.documentElement.scrollWidth") <= width
    for page in (f"runs/{shown_run.name}/trials/0", "runs"):
        chromium.open(shown_run.address + page, theme=theme, width=width)
        assert axe(chromium) == []
        assert chromium.evaluate("document.documentElement.scrollWidth") <= width


def test_it_fits_and_stands_still(chromium, shown_run):
    """Without scrolling on a screen of 1440 x 900, and what comes moves nothing."""
    chromium.open(shown_run.entrance, width=1440)
    chromium.evaluate(
        "window.shifted = 0; new PerformanceObserver((list) => list.getEntries().forEach("
        "(entry) => { window.shifted += entry.value; }))"
        ".observe({ type: 'layout-shift', buffered: true }); 0"
    )
    chromium.wait_for(f"{TRIALS} > 0")
    assert chromium.evaluate("document.querySelector('main').scrollHeight") < 840
    assert chromium.evaluate("window.shifted") < 0.05


def test_what_is_asked_is_answered_by_a_key(chromium, axe, tmp_path):
    write_study(tmp_path, study_from_mapping(axis_study(nodes=NODES, safe_search=True)))
    file = tmp_path / "said.txt"
    options = ("--backend", "inprocess", "--study", "axis.yaml", "--confirm")
    with file.open("w") as said:
        process = Fork("tune", *options, "--web", "--web-control", folder=tmp_path, stderr=said)
    try:
        wait_until(lambda: "token=" in file.read_text(), "the address", process, file.read_text)
        chromium.open(Page(process, file).entrance)
        question = "document.querySelector('#question')"
        chromium.wait_for(f"{question}?.textContent.includes('May trial 0 be tried?')")
        assert not chromium.evaluate(f"{question}.hidden")
        assert chromium.evaluate("document.title").startswith("Waiting for you")
        assert chromium.evaluate("document.querySelector('#now').hidden")
        for theme, width in (("light", 1440), ("dark", 390)):
            chromium.set_theme(theme)
            chromium.set_size(width, 900)
            assert axe(chromium) == []
            assert chromium.evaluate("document.documentElement.scrollWidth") <= width
        chromium.evaluate("dispatchEvent(new KeyboardEvent('keydown', {key: 'y'}))")
        journal = tmp_path / "runs" / "latest" / "journal.sqlite"

        def answered():
            return [event.kind for event in read_journal(journal).events][:1]

        wait_until(lambda: answered() == [EventKind.ACCEPT], "the answer", process, file.read_text)
        chromium.wait_for(f"{question}.textContent.includes('May trial 1 be tried?')")
        assert chromium.evaluate(f"{question}.querySelectorAll('.band').length") > 0
        for width in (1440, 1280, 390):
            chromium.set_size(width, 900)
            assert chromium.evaluate(UNCUT)
    finally:
        process.kill()
        process.communicate()


def test_it_pauses_continues_and_ends_the_run(chromium, run):
    def press(request):
        chromium.evaluate(f"document.querySelector('[data-request={request}]').click()")

    def shown(request):
        return f"document.querySelector('[data-request={request}]').checkVisibility()"

    chromium.open(run.entrance)
    chromium.wait_for(f"{TRIALS} > 0")
    assert chromium.evaluate(f"{shown('pause')} && !{shown('continue')} && !{shown('abort')}")
    press("pause")
    chromium.wait_for(shown("continue"))
    chromium.wait_for("document.querySelector('#now dl').textContent.includes('pauses after')")
    run.go_on()
    chromium.wait_for("document.querySelector('#state').textContent.includes('PAUSED')")
    press("continue")
    chromium.wait_for(
        f"{shown('pause')} || document.querySelector('#state').textContent.startsWith('Ended')"
    )
    assert run.finished() == 0


def test_it_ends_the_run(chromium, run):
    chromium.open(run.entrance)
    chromium.wait_for(f"{TRIALS} > 0")
    chromium.evaluate("document.querySelector('.control summary').click()")
    chromium.evaluate("document.querySelector('[data-request=abort]').click()")
    chromium.wait_for("document.querySelector('#now dl').textContent.includes('the run ends')")
    run.go_on()
    assert run.finished() == 143


def test_runs_are_chosen_and_compared(chromium, shown_run):
    chromium.open(shown_run.entrance)
    chromium.open(shown_run.address + "runs")
    rows = "document.querySelectorAll('#runs tbody tr').length"
    assert chromium.evaluate(rows) == 1
    # One run alone cannot be compared, and the page says so.
    chromium.evaluate("document.querySelector('#runs input[type=checkbox]').click()")
    chromium.evaluate("document.querySelector('#runs button.action').click()")
    chromium.wait_for("location.pathname === '/compare'")
    chromium.wait_for("document.body.textContent.includes('choose 2 to')")
