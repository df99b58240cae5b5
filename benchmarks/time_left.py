"""How well a run tells the time that it will still take.

Runs of a study by `tune --json-lines`, each with the time left as announced after every trial from
a third of the run on, and at the beginning of each later phase. The error is that of the announced
time relative to the time until the result is there, by the clock of the events. In some runs the
load of the machine changes after a quarter of the trials: two processes that compute all the time
begin there, or have computed until there.
"""

import contextlib
import os
import statistics
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from common import (
    check_end,
    events,
    provenance,
    result_parser,
    start_tuning,
    table,
    write_result,
)

BURN = "import time\nend = time.monotonic() + 900.0\nwhile time.monotonic() < end: pass"
"""Computes until it is ended, and never for longer than a run takes."""
BURNERS = 2
WITHIN = 0.2


@dataclass(frozen=True)
class Case:
    """How the runs are run: the arguments, and whether it is loaded before and after the change."""

    name: str
    arguments: Sequence[str]
    loaded: tuple[bool, bool] = (False, False)


IN_PROCESS = ("--backend", "inprocess")
CASES = (
    Case("IV", ("--algorithm", "IV", *IN_PROCESS)),
    Case("boundary", ("--algorithm", "boundary", *IN_PROCESS)),
    Case("IV, ROS", ("--algorithm", "IV")),
    Case("IV, load comes", ("--algorithm", "IV", *IN_PROCESS), (False, True)),
    Case("IV, load goes", ("--algorithm", "IV", *IN_PROCESS), (True, False)),
    Case("boundary, load comes", ("--algorithm", "boundary", *IN_PROCESS), (False, True)),
    Case("boundary, load goes", ("--algorithm", "boundary", *IN_PROCESS), (True, False)),
)


@contextlib.contextmanager
def load(wanted: bool) -> Iterator[None]:
    """Keep all cores busy, if wanted."""
    burners = [
        subprocess.Popen([sys.executable, "-c", BURN]) for _ in range(BURNERS if wanted else 0)
    ]
    try:
        yield
    finally:
        for burner in burners:
            burner.kill()
            burner.wait()


def run(arguments: Sequence[str], loaded: tuple[bool, bool]) -> list[dict[str, Any]]:
    """Run a study, with a change of the load after a quarter of its trials; return its events."""
    found: list[dict[str, Any]] = []
    with contextlib.ExitStack() as now, start_tuning(*arguments) as process:
        now.enter_context(load(loaded[0]))
        total = 0
        for event in events(process):
            found.append(event)
            if event["event"] == "run":
                total = event["trials"]
            elif event["event"] == "trial" and event["trial"] + 1 == total // 4:
                now.close()
                now.enter_context(load(loaded[1]))
    check_end(process.returncode)
    return found


def points(found: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return what was announced from a third of the run on, and what was left in truth [s]."""
    (total,) = (event["trials"] for event in found if event["event"] == "run")
    (end,) = (event["time"] for event in found if event["event"] == "result")
    announced = []
    for event in found:
        if event["event"] == "trial" and 3 * (event["trial"] + 1) >= total:
            name = f"trial {event['trial'] + 1}"
        elif event["event"] == "phase" and event["phase"] != "tuning":
            name = event["phase"]
        else:
            continue
        announced.append((name, event["time_left"], end - event["time"]))
    return [{"after": n, "announced": said, "actual": left} for n, said, left in announced]


def main() -> None:
    """Measure and report."""
    parser = result_parser(__doc__, "time_left.json")
    parser.add_argument("--study", default="benchmark", help="(default: %(default)s)")
    parser.add_argument(
        "--seeds", type=int, default=2, help="runs of a case (default: %(default)s)"
    )
    parser.add_argument("--cases", nargs="+", choices=[case.name for case in CASES], metavar="CASE")
    arguments = parser.parse_args()
    about = provenance()
    chosen = [case for case in CASES if case.name in (arguments.cases or [c.name for c in CASES])]
    result: dict[str, Any] = {}
    rows = []
    for case in chosen:
        runs: list[dict[str, Any]] = []
        for seed in range(1, arguments.seeds + 1):
            before = os.getloadavg()[0]
            with tempfile.TemporaryDirectory() as folder:
                where = ("--study", arguments.study, "--seed", str(seed), "--output", folder)
                found = points(run([*where, *case.arguments], case.loaded))
            runs.append(
                {"seed": seed, "load_average": [before, os.getloadavg()[0]], "points": found}
            )
        errors = [p["announced"] / p["actual"] - 1.0 for run in runs for p in run["points"]]
        sizes = sorted(map(abs, errors))
        summary = {
            "points": len(errors),
            "within_a_fifth": sum(size <= WITHIN for size in sizes),
            "median": statistics.median(sizes),
            "largest": sizes[-1],
            "bias": statistics.median(errors),
        }
        result[case.name] = {"loaded": case.loaded, "runs": runs, "summary": summary}
        rows.append([case.name, *summary.values()])
        print(
            table(("case", "points", "within 20 %", "median", "largest", "bias"), rows), flush=True
        )
    write_result(arguments.result, {"provenance": about, "study": arguments.study, "cases": result})


if __name__ == "__main__":
    main()
