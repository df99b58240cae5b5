"""Measure what the tuner costs, survives and is worth, and write docs/performance.md.

    python benchmarks/performance.py                    list the scripts, and write the page
    python benchmarks/performance.py recording report   run these before; `all` runs every one

Each script writes a file in benchmarks/results, with the commit, seeds and machine that it was
obtained with, from which its section of the page is made; a file that is missing is left out. A
script by itself has further options: see its --help. Scripts without a section, such as those of
choices of the algorithm and of long runs, are started by themselves.
"""

import argparse
import ast
import subprocess
import sys

from common import BENCHMARKS, RESULTS, read_result
from sections import answers, cost, faults
from sections.layout import origin

PAGE = BENCHMARKS.parent / "docs" / "performance.md"

INTRODUCTION = """\
# Performance

Written by `make performance` from files in `benchmarks/results/`, where those of further scripts
are, too. `make performance ARGS="recording"` measures again. What the tuner finds, beside the
paper and other optimizers, is in `docs/results.md`.
"""

SECTIONS = {
    "plain_problem": ("The plain problem", answers.plain_problem),
    "certificates": ("Certificates", answers.certificates),
    "example_certificates": ("Certificates of the examples", answers.example_certificates),
    "false_passes": ("Limits that are broken, and passes", answers.false_passes),
    "single_run_limits": ("Limits on single runs", answers.single_run_limits),
    "safe_search": ("Limits broken by a safe search", answers.safety),
    "simulation_prior": ("What a simulation is worth on the machine", answers.simulation_prior),
    "identify": ("Where a machine is, and whether it drifts", answers.identification),
    "estimators": ("A filter on drives that were not used", answers.estimators),
    "suggestion_time": ("Time of a proposal", cost.suggestion),
    "library": ("From Python", cost.library),
    "workers": ("Several workers", cost.workers),
    "playing": ("Runs that play a bag", cost.playing),
    "recording": ("Cost of recording", cost.recording),
    "kill_soak": ("Killed at random moments", faults.kill),
    "helper_kills": ("Processes of a command are killed", faults.helpers),
    "guard_faults": ("The guard", faults.guard),
    "freezes": ("Off the processor at random", faults.freezes),
}
"""Of each script the heading of its section, and what makes the paragraphs."""

ALL = "all"


def description(script: str) -> str:
    """Return the first line of a script's text."""
    text = ast.get_docstring(ast.parse((BENCHMARKS / f"{script}.py").read_text(encoding="utf-8")))
    return (text or "").partition("\n")[0]


def write_page() -> None:
    """Write the page from the result files."""
    parts = [INTRODUCTION.strip()]
    for script, (heading, paragraphs) in SECTIONS.items():
        result = read_result(RESULTS / f"{script}.json")
        if result is None:
            continue
        parts.append(f"## {heading}")
        parts += [origin(result), *paragraphs(result)]
    PAGE.write_text("\n\n".join(parts) + "\n", encoding="utf-8")
    print(f"wrote {PAGE}")


def main() -> None:
    """Run the scripts that are asked for, and write the page."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("scripts", nargs="*", metavar="SCRIPT")
    arguments = parser.parse_args()
    if unknown := [name for name in arguments.scripts if name not in (*SECTIONS, ALL)]:
        parser.error(f"unknown: {', '.join(unknown)}; there are {', '.join(SECTIONS)}, and {ALL}")
    chosen = list(SECTIONS) if ALL in arguments.scripts else arguments.scripts
    if not chosen:
        for script in SECTIONS:
            print(f"{script:18} {description(script)}")
    failed = [
        script
        for script in chosen
        if subprocess.run([sys.executable, BENCHMARKS / f"{script}.py"]).returncode
    ]
    write_page()
    if failed:
        sys.exit(f"error: failed: {', '.join(failed)}")


if __name__ == "__main__":
    main()
