"""The pages of a long run: size, how long they take to open and to follow, what axe-core finds.

A page is opened in a new headless Chromium with an empty profile, as by a click on the file.
Opened means that the page with all its figures is loaded. Times are those of the browser's own
clock, from the start of the navigation on. Before the report is written, the run finishes with a
live page (`long_run`).
"""

import importlib.util
import os
import re
import statistics
import tempfile
import time
from pathlib import Path
from typing import Any

from common import provenance, result_parser, table, write_result
from long_run import Chromium, finish_live, make_run
from threadpoolctl import threadpool_limits

from bo_tuner.report.page import write_report
from bo_tuner.storage.record import read_run

LOADED = "performance.getEntriesByType('navigation')[0].loadEventEnd / 1000"
AXE_DEADLINE = 1200.0
"""For its rules on all rows of a long run [s]."""
VIEWS = (("light", 1280), ("dark", 1280), ("light", 390))


def open_page(page: Path) -> tuple[float, float]:
    """Open a page in a new browser.

    Returns the seconds until it is open, and the time of the processor that the page's thread took
    for it, which other programs do not stretch.
    """
    with tempfile.TemporaryDirectory() as profile, Chromium(Path(profile)) as browser:
        browser.call("Performance.enable")
        browser.open(page)
        if browser.errors:
            raise SystemExit(f"error: {browser.errors[0]}")
        metrics = browser.call("Performance.getMetrics")["metrics"]
        (thread,) = [item["value"] for item in metrics if item["name"] == "ThreadTime"]
        return browser.evaluate(LOADED), thread


def axe_findings(page: Path, axe: str) -> list[dict[str, Any]]:
    """List what axe-core finds, in light, dark and on a phone."""
    found = []
    with tempfile.TemporaryDirectory() as profile, Chromium(Path(profile)) as browser:
        for theme, width in VIEWS:
            browser.open(page, theme=theme, width=width)
            browser.evaluate(f"{axe}; 0")
            rules = browser.evaluate(
                # What passes is not listed, which takes long with so many rows.
                "axe.run({resultTypes: ['violations']})"
                ".then(r => r.violations.map(v => [v.id, v.impact]))",
                AXE_DEADLINE,
            )
            found += [
                {"theme": theme, "width": width, "rule": rule, "impact": impact}
                for rule, impact in rules
            ]
    return found


def main() -> None:
    """Measure and report."""
    parser = result_parser(__doc__, "report.json")
    parser.add_argument("--study", default="full", help="(default: %(default)s)")
    parser.add_argument("--trials", type=int, default=1000, help="(default: %(default)s)")
    parser.add_argument(
        "--updates", type=int, default=5, help="trials with a live page (default: %(default)s)"
    )
    parser.add_argument("--opens", type=int, default=10, help="(default: %(default)s)")
    arguments = parser.parse_args()
    spec = importlib.util.find_spec("axe_core_python")
    if spec is None or spec.origin is None:
        raise SystemExit("error: axe-core-python is not installed")
    axe = Path(spec.origin).with_name("axe.min.js").read_text(encoding="utf-8")
    about = provenance(("Jinja2", "axe-core-python"))
    # As in the commands, where threads only slow down small matrices.
    with tempfile.TemporaryDirectory() as name, threadpool_limits(1):
        folder = Path(name)
        before = arguments.trials - arguments.updates
        run = make_run(folder, arguments.study, before, arguments.updates)
        live = finish_live(run, before)
        record = read_run(run)
        page = folder / "report.html"
        writing = []
        for _ in range(3):
            start = time.perf_counter()
            write_report(record, page)
            writing.append(time.perf_counter() - start)
        times = [open_page(page) for _ in range(arguments.opens)]
        findings = axe_findings(page, axe)
        size = page.stat().st_size
    opened, thread = zip(*times, strict=True)
    serious = [item for item in findings if item["impact"] in ("serious", "critical")]
    version = re.search(r"axe v([0-9.]+)", axe)
    result = {
        "provenance": about,
        "study": arguments.study,
        "trials": len(record.trials),
        "size_bytes": size,
        "seconds_to_write": writing,
        "seconds_to_open": opened,
        "processor_seconds_of_the_page": thread,
        "load_average": os.getloadavg(),
        "live": live,
        "axe_version": version.group(1) if version else "unknown",
        "axe_findings": findings,
    }
    write_result(arguments.result, result)
    measured = {
        "write": writing,
        "open": opened,
        "processor time of the page": thread,
        "live page: state after a trial": live["delay_of_state"],
        "live page: table after a trial": live["delay_of_table"],
    }
    rows = [(what, statistics.median(s), min(s), max(s)) for what, s in measured.items()]
    print(table(("report", "median [s]", "min", "max"), rows))
    print(
        f"{len(record.trials)} trials, {size / 1e6:.2f} MB; axe-core {result['axe_version']}: "
        f"{len(findings)} findings, {len(serious)} of them serious"
    )
    parts = [f"{part} {live[f'seconds_to_{part}']:.2f} s" for part in ("load", "table", "answer")]
    print(f"live page: {', '.join(parts)}")


if __name__ == "__main__":
    main()
