"""Write docs/performance.md from the result files of the other benchmark scripts.

Every figure on the page comes from a file in benchmarks/results, with the commit, seeds and machine
that it was obtained with; a file that is missing is left out.
"""

import argparse

from common import RESULTS, read_result
from sections import answers, cost, faults
from sections.layout import origin

PAGE = RESULTS.parents[1] / "docs" / "performance.md"

INTRODUCTION = """\
# Performance

Written by `python benchmarks/results_page.py` from the files in `benchmarks/results/`; each section
names the command that measured it, its commit, seeds and machine. What the tuner finds, beside the
paper and beside other optimizers, is in `docs/results.md`.
"""


SECTIONS = (
    ("certificates.json", "Certificates", answers.certificates),
    ("repeated_certificates.json", "Certificates after a FAIL", answers.repeated),
    ("ablations.json", "Choices of the algorithm `boundary`", answers.ablations),
    ("suggestion_time.json", "Time of a proposal", cost.suggestion),
    ("closed_loop.json", "Cost of a cut, as ratios", cost.closed_loop),
    ("recording.json", "Cost of recording", cost.recording),
    ("live_overhead.json", "Cost of live monitoring", cost.live),
    ("web_overhead.json", "Cost of the live page", cost.web),
    ("band_coverage.json", "Bands and bounds of a certificate", answers.coverage),
    ("parameter_effects.json", "What a parameter moves", answers.effects),
    ("stop_advice.json", "The advice to stop", answers.stop),
    ("unchanged_system.json", "A system that knows nothing of the tuner", cost.unchanged),
    ("node_starts.json", "A node that starts with its values", cost.node_starts),
    ("streams.json", "References that stream", cost.streams),
    ("report.json", "The report", cost.report),
    ("soak.json", "Many cuts over ROS", faults.soak),
    ("kill_soak.json", "Killed at random moments", faults.kill),
    ("command_kills.json", "Commands killed, and begun again", faults.command_kill),
    ("guard_faults.json", "The guard", faults.guard),
    ("fuzz.json", "Hostile input", faults.fuzz),
)
"""File, heading, and what makes the paragraphs."""


def main() -> None:
    """Write the page."""
    argparse.ArgumentParser(description=__doc__.partition("\n")[0]).parse_args()
    parts = [INTRODUCTION.strip()]
    for name, heading, paragraphs in SECTIONS:
        result = read_result(RESULTS / name)
        if result is None:
            continue
        parts.append(f"## {heading}")
        # The parts of a result that came about one by one tell it themselves.
        if "provenance" in result:
            parts.append(origin(result))
        parts += paragraphs(result)
    PAGE.write_text("\n\n".join(parts) + "\n", encoding="utf-8")
    print(f"wrote {PAGE}")


if __name__ == "__main__":
    main()
