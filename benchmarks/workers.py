"""What several workers gain: whole runs of an object that sleeps, with 1, 2, 4 and 8 of them.

    nice .venv/bin/python benchmarks/workers.py [--sleep S] [--trials N] [--draws N]

All have the same window, so that they run the same evaluations. An evaluation sleeps, as one whose
nodes wait does, so that the ratios say little of the machine. The start of the workers is told
apart: that of a pool which runs nothing.
"""

import argparse
import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path

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
WORKERS = (1, 2, 4, 8)


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
    program = str(Path(sys.executable).with_name(command))
    done = subprocess.run(
        [program, *map(str, arguments)], cwd=folder, capture_output=True, text=True, check=False
    )
    if done.returncode not in (0, 3):
        raise SystemExit(f"{command}: {done.stderr}")
    return time.monotonic() - begin


def main() -> None:
    """Print a row for each number of workers."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--sleep", type=float, default=2.0, help="of an evaluation [s]")
    parser.add_argument("--trials", type=int, default=24)
    parser.add_argument("--draws", type=int, default=100)
    parser.add_argument("--most", type=int, default=max(WORKERS), help="workers")
    options = parser.parse_args()
    window = max(WORKERS)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "sleeping_axis.py").write_text(OBJECT, encoding="utf-8")
        file = folder / "study.yaml"
        short = folder / "start.yaml"
        file.write_text(json.dumps(study(options.sleep, options.trials)), encoding="utf-8")
        short.write_text(json.dumps(study(0.0, 1)), encoding="utf-8")
        print("workers  start [s]  tune [s]  ratio  validate [s]  ratio")
        first: tuple[float, float] | None = None
        alone = 0.0
        for workers in (count for count in WORKERS if count <= options.most):
            new = ("--backend", "inprocess", "--window", window, "--workers", workers)
            empty = seconds(folder, "tune", "--study", short, *new, "--output", "start")
            alone = alone or empty
            tune = seconds(folder, "tune", "--study", file, *new, "--output", f"runs-{workers}")
            validate = seconds(
                folder, "validate", f"runs-{workers}/latest", "--window", window, "--workers",
                workers, "--draws", options.draws,
            )  # fmt: skip
            first = first or (tune, validate)
            print(
                f"{workers:7}  {empty - alone:9.1f}  {tune:8.1f}  {first[0] / tune:5.2f}  "
                f"{validate:12.1f}  {first[1] / validate:5.2f}",
                flush=True,
            )


if __name__ == "__main__":
    main()
