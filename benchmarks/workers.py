"""What several workers gain: whole runs of an object that sleeps, with 1, 2, 4, 8 and 16 of them.

All have the same window, so that they run the same evaluations. An evaluation sleeps, as one whose
nodes wait does, so that the ratios say little of the machine. The start of the workers is told
apart: that of a run which evaluates next to nothing, beyond what it takes with one worker.
"""

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from common import A_RESULT, provenance, result_parser, table, write_result
from sections.cost import WORKERS_HEADER as HEADER
from sections.cost import speedups

OBJECT = """\
import time


class Axis:
    def set_parameters(self, values):
        self.__dict__.update(values)

    def evaluate(self):
        time.sleep(self.sleep)
        noise = 0.001 * (self.seed % 100)
        error = 25 * (self.gain - 0.3) ** 2 + self.load + noise
        return {"status": "ok", "error": error, "peak": self.load * self.gain + noise}
"""
WORKERS = (1, 2, 4, 8, 16)
WINDOW = 8
"""Of the trials: more workers have room in the validation and in the certificate."""


def study(sleep: float, trials: int) -> dict[str, object]:
    """Return a study of the object as a mapping."""
    node = {"node": "axis"}
    axis = node | {"result": "~/result", "object": "sleeping_axis:Axis"}
    tuned = node | {"type": "double", "bounds": [0.0, 1.0], "default": 0.5}
    return {
        "name": "sleeping",
        "nodes": {"axis": axis | {"parameters": {"sleep": sleep}}},
        "parameters": {"gain": tuned},
        "contexts": {"load": node | {"distribution": "uniform", "bounds": [1.0, 2.0]}},
        "seed_parameter": node | {"parameter": "seed"},
        "trigger": node | {"service": "~/run"},
        "metrics": {"error": node, "peak": node},
        "objective": {"metric": "error"},
        "constraints": {
            "peak": {"kind": "chance", "metric": "peak", "upper": 1.0, "probability": 0.9}
        },
        "budget": {"trials": trials, "initial_trials": min(8, trials)},
    }


def seconds(folder: Path, command: str, *arguments: object) -> float:
    """Run a command to its end, and return how long it took [s]."""
    begin = time.monotonic()
    done = subprocess.run(
        [sys.executable, "-m", "bo_tuner", command, *map(str, arguments)],
        cwd=folder,
        capture_output=True,
        text=True,
        check=False,
    )
    if done.returncode not in A_RESULT:
        raise SystemExit(f"{command}: {done.stderr}")
    return time.monotonic() - begin


def compared(folder: Path, sleep: float, trials: int, draws: int) -> Iterator[dict[str, Any]]:
    """Yield for each number of workers what it took [s]."""
    file = folder / "study.yaml"
    file.write_text(json.dumps(study(sleep, trials)), encoding="utf-8")
    short = folder / "start.yaml"
    short.write_text(json.dumps(study(0.0, 1)), encoding="utf-8")
    for workers in WORKERS:
        new = ("--backend", "inprocess", "--window", WINDOW, "--workers", workers)
        runs = f"runs-{sleep:g}-{workers}"
        yield {
            "workers": workers,
            "start": seconds(folder, "tune", "--study", short, *new, "--output", "start"),
            "tune": seconds(folder, "tune", "--study", file, *new, "--output", runs),
            "validate": seconds(
                folder, "validate", f"{runs}/latest", "--window", max(WORKERS), "--workers",
                workers, "--runs", draws,
            ),
        }  # fmt: skip


def main() -> None:
    """Print a row for each number of workers, and write the result."""
    parser = result_parser(__doc__, "workers.json")
    parser.add_argument("--sleep", type=float, nargs="+", default=[5.0, 1.0], help="[s]")
    parser.add_argument("--trials", type=int, default=12)
    parser.add_argument("--draws", type=int, default=60)
    options = parser.parse_args()
    result: dict[str, Any] = {
        "provenance": provenance(),
        "trials": options.trials,
        "window": WINDOW,
        "cores": os.cpu_count(),
        "load_before": os.getloadavg()[0],
        "sleeps": [],
    }
    for sleep in options.sleep:
        rows: list[dict[str, Any]] = []
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            (folder / "sleeping_axis.py").write_text(OBJECT, encoding="utf-8")
            for row in compared(folder, sleep, options.trials, options.draws):
                rows.append(row)
                print(sleep, row, flush=True)
        result["sleeps"].append({"sleep": sleep, "rows": rows})
        write_result(options.result, result)
    for item in result["sleeps"]:
        print(table(HEADER, speedups(item["rows"])))


if __name__ == "__main__":
    main()
