"""Write docs/performance.md from the result files of the other benchmark scripts.

Every figure on the page comes from a file in benchmarks/results, with the commit, seeds and machine
that it was obtained with; a file that is missing is left out.
"""

import argparse
import json

from common import RESULTS
from sections import answers, cost, faults
from sections.layout import Result

PAGE = RESULTS.parents[1] / "docs" / "performance.md"

INTRODUCTION = """\
# Performance

Written by `python benchmarks/results_page.py` from the files in `benchmarks/results/`; each section
names the command that measured it, its commit, seeds and machine. What the tuner finds, beside the
paper and beside other optimizers, is in `docs/results.md`.
"""


def load(name: str) -> Result | None:
    """Read a result file, or None if there is none."""
    path = RESULTS / name
    return json.loads(path.read_text(encoding="utf-8")) if path.exists() else None


def main() -> None:
    """Write the page."""
    argparse.ArgumentParser(description=__doc__.partition("\n")[0]).parse_args()
    sections = [INTRODUCTION]
    for name, section in (
        ("certificates.json", answers.certificates),
        ("ablations.json", answers.ablations),
        ("suggestion_time.json", cost.suggestion),
        ("closed_loop.json", cost.closed_loop),
        ("recording.json", cost.recording),
        ("live_overhead.json", cost.live),
        ("web_overhead.json", cost.web),
        ("time_left.json", cost.time_left),
        ("band_coverage.json", answers.coverage),
        ("stop_advice.json", answers.stop),
        ("unchanged_system.json", cost.unchanged),
        ("report.json", cost.report),
        ("soak.json", faults.soak),
        ("kill_soak.json", faults.kill),
        ("command_kills.json", faults.command_kill),
        ("fuzz.json", faults.fuzz),
    ):
        if (result := load(name)) is not None:
            sections.append(section(result))
    PAGE.write_text("\n\n".join(part.strip() for part in sections) + "\n", encoding="utf-8")
    print(f"wrote {PAGE}")


if __name__ == "__main__":
    main()
