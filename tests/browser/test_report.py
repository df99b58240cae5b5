"""The report as a reader sees it: in a browser, on a phone, in the dark, on paper."""

import json
import re
import shutil

import pytest
import yaml
from points import middles, mouse, press

from bo_tuner.storage.record import read_run
from bo_tuner.trials import Stage
from bo_tuner.web.runs import Runs

pytestmark = pytest.mark.slow

INK = """
    getComputedStyle(document.querySelector('.plot .axes text')).fill.match(/[0-9]+/g)
        .slice(0, 3).map(Number).reduce((a, b) => a + b)
"""


def opened(chromium, page, *, theme="light", width=1280):
    chromium.open(page, theme=theme, width=width)
    return chromium


def kept_open(chromium, page, *, theme="light", width=1280):
    """The page as `opened`, for tests that change nothing: opened once for several in a row."""
    if chromium.untouched != (page, theme, width):
        opened(chromium, page, theme=theme, width=width)
        chromium.untouched = (page, theme, width)
    return chromium


def requests_elsewhere(browser):
    return [url for url in browser.requests if not url.startswith(("file:", "data:", "blob:"))]


@pytest.mark.parametrize("theme", ["dark", "light"])
def test_every_panel_is_drawn_without_an_error(chromium, feed_axis_page, theme):
    browser = kept_open(chromium, feed_axis_page, theme=theme)
    drawn = browser.evaluate(
        "[...document.querySelectorAll('figure')].filter(f => !f.closest('details'))"
        ".map(f => [f.id, [...f.querySelectorAll('.plot .axes')].map(a => "
        "parseFloat(getComputedStyle(a).width))])"
    )
    names = {name.removeprefix("figure-") for name, _ in drawn}
    assert names >= {
        "response", "convergence", "worst-cases", "contexts", "trajectories", "slices", "contours",
    }  # fmt: skip
    assert all(min(widths) > 100 for _, widths in drawn)
    assert browser.errors == []
    assert requests_elsewhere(browser) == []


def test_the_numbers_shown_are_those_of_the_journal(chromium, feed_axis_page, feed_axis_run):
    browser = kept_open(chromium, feed_axis_page)
    cells = browser.evaluate(
        "Object.fromEntries([...document.querySelectorAll('#answer tbody tr')].map(row => "
        "[row.cells[0].firstChild.textContent.trim(), "
        "[row.cells[1].textContent, row.cells[2].textContent]]))"
    )
    record = read_run(feed_axis_run)
    evaluations = [r for r in record.evaluations if r.stage is Stage.VALIDATION]
    for column in (0, 1):
        of_column = [
            evaluation.outcome.metrics for evaluation in evaluations if evaluation.trial == column
        ]
        assert len(of_column) == record.study.budget.validation_draws
        errors = [metrics["tracking_error"] for metrics in of_column]
        overshoots = [metrics["overshoot"] for metrics in of_column]
        assert cells["tracking_error [(m/s)^2]"][column] == f"{sum(errors) / len(errors):.4g}"
        assert cells["overshoot [m/s]"][column] == f"{max(overshoots):.4g}"
    best = record.trials[record.summary["trial"]].parameters
    assert cells["lambda_mpc"][1] == f"{best['lambda_mpc']:.4g}"
    assert cells["control_horizon [samples]"][1] == str(best["control_horizon"])


def test_a_point_tells_of_its_own_trial(chromium, feed_axis_page, feed_axis_run):
    """The panels of a figure share their texts."""
    browser = kept_open(chromium, feed_axis_page)
    shown = browser.evaluate(
        "(() => { const figure = document.querySelector('#figure-slices');"
        "const texts = JSON.parse(figure.querySelector('script').textContent);"
        "return [...figure.querySelectorAll('.axes')].map(a => [a.dataset.x, "
        "[...a.querySelectorAll('use[data-tip]')].map(u => "
        "[texts[u.dataset.tip], parseFloat(u.getAttribute('x'))])]); })()"
    )
    trials = {trial.number: trial for trial in read_run(feed_axis_run).trials}
    tuned = read_run(feed_axis_run).study.search_space().names
    seen = 0
    for axis, points in shown:
        numbered = [(int(re.match(r"trial (\d+)", text)[1]), x) for text, x in points]
        low, high = map(float, axis.split()[:2])
        if axis.endswith("log") or not points:
            continue
        assert any(
            all(
                x
                == pytest.approx(100 * (trials[n].parameters[name] - low) / (high - low), abs=0.01)
                for n, x in numbered
            )
            for name in tuned
        )
        seen += 1
    assert seen > 0


@pytest.mark.parametrize("width", [1440, 1280, 390])
def test_the_table_of_the_first_screen_is_seen_whole(chromium, feed_axis_page, width):
    """Every bar is within it, with the limit on the bar."""
    browser = kept_open(chromium, feed_axis_page, width=width)
    scroll = "document.querySelector('.gains .scroll')"
    assert browser.evaluate(f"{scroll}.scrollWidth <= {scroll}.clientWidth + 1")
    boxes = browser.evaluate(
        "[...document.querySelectorAll('.against')].map(bar => [bar, bar.querySelector('.limit')]"
        ".map(part => part.getBoundingClientRect()).map(({left, right}) => [left, right]))"
    )
    assert len(boxes) == 2
    # The marks on a bar are those of its values alone.
    assert browser.evaluate(
        "[...document.querySelectorAll('.against')].every(bar => ['::before', '::after']"
        ".every(part => getComputedStyle(bar, part).content === 'none'))"
    )
    for (left, right), (begin, end) in boxes:
        assert left < begin < end < right <= width


@pytest.mark.parametrize(("width", "height"), [(1280, 800), (390, 844)])
def test_the_values_are_on_the_first_screen(chromium, feed_axis_page, width, height):
    browser = opened(chromium, feed_axis_page, width=width)
    browser.set_size(width, height)
    box = browser.evaluate(
        "(({bottom, right}) => [bottom, right])"
        "(document.querySelector('.values table').getBoundingClientRect())"
    )
    assert box[0] <= height
    assert box[1] <= width
    assert browser.evaluate("scrollY") == 0


def test_the_values_can_be_copied(chromium, feed_axis_page, feed_axis_run):
    browser = opened(chromium, feed_axis_page)
    told = browser.evaluate("document.querySelector('button.action.copy').dataset.copy")
    assert yaml.safe_load(told) == yaml.safe_load((feed_axis_run / "best.yaml").read_text())
    hidden = "[...document.querySelectorAll('button.copy')].filter(b => b.hidden).length"
    assert browser.evaluate(hidden) == 0


def test_without_scripts_every_panel_is_a_picture(chromium, feed_axis_page):
    browser = chromium
    browser.call("Emulation.setScriptExecutionDisabled", value=True)
    try:
        browser.open(feed_axis_page)
        missing = browser.call("DOM.getDocument", depth=-1)
        found = json.dumps(missing)
        pictures = len(re.findall(r'"class", "axes"', found))
        panels = len(re.findall(r'"plot", "style"', found))
        assert pictures == panels > 10
    finally:
        browser.call("Emulation.setScriptExecutionDisabled", value=False)
        browser.open("about:blank")


def test_a_tip_does_not_cover_the_axes(chromium, feed_axis_page):
    """Beside the first and the last trial, which are next to the edges."""
    browser = opened(chromium, feed_axis_page)
    found = sorted(middles(browser, "figure-convergence"), key=lambda item: item[1])
    plot = "document.querySelector('#figure-convergence .plot')"

    def box_of(part):
        return browser.evaluate(
            "(({left, top, right, bottom}) => [left, top, right, bottom])"
            f"({plot}.querySelector('{part}').getBoundingClientRect())"
        )

    edges = browser.evaluate(
        f"(() => {{ const b = {plot}.querySelector('.axes > .ticks line').getBoundingClientRect();"
        f"return [b.top, b.bottom]; }})()"
    )
    for trial, x, y in (found[0], found[-1]):
        mouse(browser, "Moved", x, y)
        browser.wait_for(f"{plot}.querySelector('.tip:not([hidden])') !== null")
        _, top, _, bottom = box_of(".tip")
        assert edges[0] - 1 <= top
        assert bottom <= edges[1] + 1
        assert browser.evaluate(f"{plot}.querySelector('.tip').textContent").startswith(
            f"trial {trial}"
        )
        mouse(browser, "Moved", 1, 1)
        browser.wait_for(f"{plot}.querySelector('.tip:not([hidden])') === null")
    assert browser.errors == []


def test_points_are_reached_by_the_keyboard(chromium, feed_axis_page):
    """One stop of the tabulator a panel; arrows go from point to point."""
    browser = opened(chromium, feed_axis_page)
    plot = "document.querySelector('#figure-convergence .plot')"
    browser.evaluate(f"{plot}.focus()")
    assert browser.evaluate(f"document.activeElement === {plot}")
    tip = f"{plot}.querySelector('.tip:not([hidden])')"

    def key(name):
        for kind in ("keyDown", "keyUp"):
            browser.call("Input.dispatchKeyEvent", type=kind, key=name)

    told = []
    for name in ("ArrowRight", "ArrowRight", "ArrowLeft"):
        key(name)
        told.append(browser.evaluate(f"{tip}.textContent"))
    assert told[0] == told[2] != told[1]
    while (trial := re.match(r"trial (\d+)", browser.evaluate(f"{tip}.textContent"))) is None:
        key("ArrowRight")
    key("Enter")
    row = "document.querySelector('#all-trials tr.sought')"
    assert browser.evaluate(f"Number({row}.cells[0].textContent)") == int(trial[1])
    browser.evaluate(f"{plot}.focus()")
    key("ArrowRight")
    key("Escape")
    assert browser.evaluate(f"{tip} === null")
    assert browser.errors == []


def test_a_drag_zooms_in_and_a_double_click_out(chromium, feed_axis_page):
    browser = opened(chromium, feed_axis_page)
    axes = "document.querySelector('#figure-trajectories .plot .axes')"
    browser.evaluate(f"{axes}.scrollIntoView({{block: 'center'}})")
    numbers = f"[...{axes}.querySelectorAll('.ticks text')].map(t => t.textContent)"
    view = f"{axes}.querySelector('.stretched').viewBox.baseVal"
    before = browser.evaluate(numbers)
    x, y, width, height = browser.evaluate(
        f"(() => {{ const b = {axes}.getBoundingClientRect(), s = getComputedStyle({axes});"
        "return [b.x, b.y, parseFloat(s.width), parseFloat(s.height)]; })()"
    )
    ends = [(x + 0.25 * width, y + 0.5 * height), (x + 0.75 * width, y + 0.5 * height)]
    mouse(browser, "Moved", *ends[0])
    mouse(browser, "Pressed", *ends[0], button="left", clickCount=1)
    mouse(browser, "Moved", *ends[1], button="left")
    mouse(browser, "Released", *ends[1], button="left", clickCount=1)
    # Along the axis of the drag only.
    shown = browser.evaluate(f"(v => [v.x, v.y, v.width, v.height])({view})")
    assert shown == pytest.approx([250.0, 0.0, 500.0, 1000.0], abs=5.0)
    assert browser.evaluate(numbers) != before
    browser.evaluate(f"{axes}.dispatchEvent(new MouseEvent('dblclick', {{ bubbles: true }}))")
    assert browser.evaluate(numbers) == before
    assert browser.evaluate(f"(v => [v.x, v.width])({view})") == [0.0, 1000.0]
    assert browser.errors == []


def test_what_is_closed_is_drawn_when_it_is_opened(chromium, feed_axis_page):
    browser = opened(chromium, feed_axis_page)
    browser.evaluate("document.querySelector('#details summary').click()")
    width = "document.querySelector('#figure-time .axes').getBoundingClientRect().width"
    browser.wait_for(f"{width} > 300")
    assert browser.errors == []


def test_a_legend_hides_and_shows(chromium, feed_axis_page):
    browser = opened(chromium, feed_axis_page)
    button = "document.querySelector('#figure-trajectories button[data-name=tuned]')"
    lines = "document.querySelectorAll('#figure-trajectories g[data-name]:not([hidden])').length"
    before = browser.evaluate(lines)
    browser.evaluate(f"{button}.click()")
    assert browser.evaluate(f"{button}.getAttribute('aria-pressed')") == "false"
    # One line of the tuned parameter set in each panel.
    panels = browser.evaluate("document.querySelectorAll('#figure-trajectories .plot').length")
    assert browser.evaluate(lines) == before - panels
    browser.evaluate(f"{button}.click()")
    assert browser.evaluate(lines) == before


def test_texts_of_a_study_do_no_harm(chromium, harmful_page):
    browser = opened(chromium, harmful_page)
    browser.wait_for("document.querySelector('#failures table') !== null")
    assert browser.evaluate("'harmed' in window") is False
    assert browser.errors == []
    assert requests_elsewhere(browser) == []
    # Shown as it is, in the page and in a figure.
    harm = "<script>window.harmed = 1</script>"
    assert harm in browser.evaluate("document.querySelector('#failures table').textContent")
    assert harm in browser.evaluate("document.querySelector('#figure-slices').textContent")


TRIALS = "document.querySelector('#trials table.sortable')"
SHOWN = (
    f"[...{TRIALS}.tBodies[0].rows].filter(r => !r.hidden)"
    ".map(r => [...r.cells].map(c => c.textContent.trim()))"
)


def test_the_trials_can_be_sorted_by_value(chromium, feed_axis_page):
    browser = opened(chromium, feed_axis_page)
    head = f"[...{TRIALS}.tHead.rows[0].cells].find(c => c.textContent.startsWith('lambda_mpc'))"
    column = browser.evaluate(f"{head}.cellIndex")
    for order in ("ascending", "descending"):
        browser.evaluate(f"{head}.querySelector('button').click()")
        assert browser.evaluate(f"{head}.getAttribute('aria-sort')") == order
        found = [float(row[column]) for row in browser.evaluate(SHOWN)]
        assert found == sorted(found, reverse=order == "descending")
    assert browser.errors == []


def test_the_trials_can_be_filtered_by_words(chromium, feed_axis_page, feed_axis_run):
    browser = opened(chromium, feed_axis_page)

    def filtered(words):
        browser.evaluate(
            "(() => { const input = document.querySelector('#trials .filter input');"
            f"input.value = {json.dumps(words)}; input.dispatchEvent(new Event('input')); }})()"
        )
        return browser.evaluate(SHOWN)

    record = read_run(feed_axis_run)
    (result,) = filtered("result")
    assert result[0] == str(record.summary["trial"])
    assert filtered("result nowhere") == []
    assert len(filtered("")) == len(record.trials)


def test_a_wide_table_says_on_a_phone_that_it_scrolls(chromium, feed_axis_page):
    browser = opened(chromium, feed_axis_page, width=390)
    browser.evaluate("document.querySelectorAll('details').forEach(d => { d.open = true })")
    cues = """[...document.querySelectorAll('.scroll')].map(s => [s.scrollWidth > s.clientWidth + 1,
        s.previousElementSibling?.matches('.cue:not([hidden])') ?? false])"""
    browser.wait_for(f"{cues}.every(([wide, cue]) => wide === cue)")
    assert any(wide for wide, _ in browser.evaluate(cues))
    # What a table is about is read without scrolling it.
    ends = browser.evaluate(
        "[...document.querySelectorAll('caption:not(.hidden)')]"
        ".map(c => c.getBoundingClientRect().right)"
    )
    assert max(ends) <= 390
    assert browser.evaluate("document.documentElement.scrollWidth") <= 390
    # What has many words in a cell scrolls, too, instead of standing there word by word.
    widths = browser.evaluate(
        "[...document.querySelectorAll('td:not(.number):not(.text)')].filter(c => "
        "c.textContent.trim().length > 24).map(c => c.getBoundingClientRect().width)"
    )
    assert min(widths) >= 9 * 16


@pytest.mark.parametrize("width", [1280, 390])
def test_sentences_in_the_list_of_runs_have_room(chromium, feed_axis_run, tmp_path, width):
    """However long the name of a run or of a study is, no verdict stands there word by word."""
    name = "a_study_with_a_long_name_that_goes_on_and_on-20260801-101500"
    shutil.copytree(feed_axis_run, tmp_path / "runs" / name)
    page = tmp_path / "runs.html"
    page.write_text(Runs(tmp_path / "runs", "").listing(), encoding="utf-8")
    browser = opened(chromium, page, width=width)
    heads = browser.evaluate(
        "[...document.querySelectorAll('#runs th[scope=col]')].map(h => "
        "[h.textContent.trim(), h.getBoundingClientRect().width])"
    )
    assert dict(heads)["run"] <= 15 * 16 + 1
    # On a phone each run is a card, without the head of the table.
    sentences = browser.evaluate(
        "[...document.querySelectorAll('#runs tbody td')].filter(c => "
        "c.textContent.trim().length > 40).map(c => c.getBoundingClientRect().width)"
    )
    assert sentences
    assert min(sentences) > 180
    names = browser.evaluate(
        "[...document.querySelectorAll('#runs tbody a')].map(a => a.getBoundingClientRect().right)"
    )
    assert max(names) <= width


def test_a_point_of_the_front_opens_what_is_to_know_of_it(chromium, front_page):
    browser = opened(chromium, front_page)
    choices = "[...document.querySelectorAll('#front details.choice')]"
    numbers = browser.evaluate(f"{choices}.map(c => Number(c.dataset.trial))")
    assert len(numbers) > 1
    for number in numbers[:2]:
        press(browser, "figure-front", number)
        # One at a time.
        opened_ones = f"{choices}.filter(c => c.open).map(c => Number(c.dataset.trial))"
        browser.wait_for(f"JSON.stringify({opened_ones}) === '[{number}]'")
        plot = f"document.querySelector('#figure-response-{number} .axes')"
        browser.wait_for(f"{plot}.getBoundingClientRect().width > 100")
        shown = f"{choices}.find(c => c.open)"
        commands = browser.evaluate(
            f"[...{shown}.querySelectorAll('code')].map(c => c.textContent)"
        )
        title = browser.evaluate(f"{shown}.querySelector('summary').textContent")
        # Those for the result stand with it.
        if ", the result" not in title:
            assert [command.split()[0] for command in commands] == ["validate", "apply"]
            assert all(command.endswith(f" --trial {number}") for command in commands)
    assert browser.errors == []


def test_a_slider_shows_what_is_predicted(chromium, front_page):
    """Of one parameter at a time: a page by itself has no models."""
    browser = opened(chromium, front_page)
    sliders = "document.querySelector('.what-if')"
    cells = f"[...{sliders}.querySelectorAll('tbody td:nth-child(2)')].map(c => c.textContent)"
    data = browser.evaluate(f"JSON.parse({sliders}.querySelector('script').textContent)")
    (slider,), (along,) = data["sliders"], data["along"]
    before = browser.evaluate(cells)
    assert before == along[slider["place"]]["cells"]
    browser.evaluate(
        f"(() => {{ const input = {sliders}.querySelector('input'); input.value = 2;"
        "input.dispatchEvent(new Event('input')); })()"
    )
    assert browser.evaluate(cells) == along[2]["cells"] != before
    command = browser.evaluate(f"{sliders}.querySelector('code').textContent")
    name, value = command.rpartition(" --set ")[2].split("=")
    assert (name, float(value)) == (slider["name"], slider["values"][2])
    said = f"[{sliders}.querySelector('output').textContent, {sliders}.querySelector('input')"
    assert browser.evaluate(f"{said}.getAttribute('aria-valuetext')]") == [slider["words"][2]] * 2
    browser.evaluate(f"{sliders}.querySelector('button').click()")
    assert browser.evaluate(cells) == before
    assert browser.errors == []


@pytest.mark.parametrize(("theme", "width"), [("light", 1280), ("dark", 390)])
def test_axe_finds_nothing_in_what_can_be_chosen(chromium, front_page, axe, theme, width):
    browser = opened(chromium, front_page, theme=theme, width=width)
    browser.evaluate("document.querySelector('#front details.choice').open = true")
    assert axe(browser) == []
    assert browser.evaluate("document.documentElement.scrollWidth") <= width


def test_the_figures_follow_the_theme(chromium, feed_axis_page):
    browser = opened(chromium, feed_axis_page, theme="light")
    light = browser.evaluate(INK)
    browser.set_theme("dark")
    browser.wait_for(f"({INK}) !== {light}")
    dark = browser.evaluate(INK)
    assert light < 3 * 100 < 3 * 150 < dark


def test_it_prints(chromium, feed_axis_page, tmp_path):
    browser = opened(chromium, feed_axis_page, theme="dark")
    browser.print_pdf(tmp_path / "report.pdf")
    content = (tmp_path / "report.pdf").read_bytes()
    assert content.startswith(b"%PDF")
    assert 3 <= len(re.findall(rb"/Type\s*/Page\b", content)) <= 8
    # Dark ink on paper, whatever the screen is like.
    assert browser.evaluate(INK) > 3 * 150
    browser.call("Emulation.setEmulatedMedia", media="print")
    assert browser.evaluate(INK) < 3 * 100
    assert browser.errors == []


PAPER = 688
"""Width of A4 between margins of 14 mm [px]."""


def test_a_table_of_many_columns_fits_the_paper(chromium, feed_axis_page):
    browser = opened(chromium, feed_axis_page, width=PAPER)
    browser.evaluate(
        "[...document.querySelectorAll('#all-trials table tr')].forEach(row => "
        "{ for (let k = 0; k < 13; k++) row.append(row.cells[2].cloneNode(true)) })"
    )
    browser.call("Emulation.setEmulatedMedia", media="print")
    browser.evaluate("document.querySelectorAll('details').forEach(d => { d.open = true })")
    ends = browser.evaluate(
        "[...document.querySelectorAll('table')].map(t => t.getBoundingClientRect().right)"
    )
    assert len(ends) > 3
    assert max(ends) <= PAPER + 1
    assert browser.evaluate("document.querySelector('#all-trials table').rows[0].cells.length") > 20


def test_a_phone_needs_no_sideways_scrolling(chromium, feed_axis_page):
    browser = kept_open(chromium, feed_axis_page, width=390)
    assert browser.evaluate("document.documentElement.scrollWidth") <= 390
    ends = browser.evaluate(
        "[...document.querySelectorAll('.plot')].map(s => s.getBoundingClientRect().right)"
    )
    assert max(ends) <= 390


@pytest.mark.parametrize(("theme", "width"), [("light", 390), ("light", 1280), ("dark", 1280)])
def test_axe_finds_nothing_serious(chromium, feed_axis_page, axe, theme, width):
    browser = kept_open(chromium, feed_axis_page, theme=theme, width=width)
    # A phone has the colours of the light page, and contrast takes axe the longest.
    found = axe(browser, contrast=width > 400)
    assert [name for name, impact in found if impact in ("serious", "critical")] == []


def test_axe_finds_a_fault(chromium, axe, tmp_path):
    page = tmp_path / "faulty.html"
    page.write_text("<!doctype html><html><body><img></body></html>")
    chromium.open(page)
    assert ("image-alt", "critical") in axe(chromium)


def test_a_response_is_played(chromium, feed_axis_page):
    """What was measured comes up as time goes on; limits stand, and in the end all is as before."""
    chromium.open(feed_axis_page)
    figure = "document.querySelector('#answer figure')"
    button = f"{figure}.querySelector('button.play')"
    cut = (
        f"[...{figure}.querySelectorAll('path')].filter(line => line.style.clipPath)"
        ".map(line => line.closest('[data-name]').dataset.name)"
    )
    assert chromium.evaluate(cut) == []
    chromium.evaluate(f"{button}.click()")
    chromium.wait_for(f"{cut}.includes('default') && {cut}.includes('tuned')")
    assert not any("limit" in name for name in chromium.evaluate(cut))
    assert chromium.evaluate(f"{figure}.querySelectorAll('.cursor').length") > 0
    chromium.evaluate(f"{button}.click()")
    assert chromium.evaluate(cut) == []
    assert chromium.evaluate(f"{figure}.querySelectorAll('.cursor').length") == 0
    # Only where something moves in time.
    assert chromium.evaluate("document.querySelectorAll('#contexts button.play').length") == 0
    assert chromium.errors == []
