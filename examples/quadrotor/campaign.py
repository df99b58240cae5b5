"""Tunes the quadrotor, once for each seed, and compares the results on a dense grid of conditions.

For each seed it calls `tune` and `validate` as a user would. Then it judges RotorPy's gains, those
of Ziegler and Nichols, and each result (judge.py), and writes all of it to one JSON file with
commit, seeds, machine and times. Run it from the root of the repository.
"""

import argparse
import json
import platform
import subprocess
import sys
import time
from collections.abc import Iterable, Mapping
from concurrent.futures import Executor, ProcessPoolExecutor
from dataclasses import replace
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from classical import ziegler_nichols
from judge import DEFAULT, Conditions, Gains, Judgement, grid, judge_all

HERE = Path(__file__).parent
STUDY = HERE / "study.yaml"
COMPLETE = (0, 3)
"""Exit codes of `tune` and `validate` that do not mean that something went wrong."""
REPEATS = 5  # flights in the worst condition, each with gusts and noise of its own


def command(name: str, *arguments: object) -> tuple[int, float]:
    """Run a command of the tuner; return its exit code and how long it took [s]."""
    began = time.monotonic()
    program = Path(sys.executable).parent / name
    code = subprocess.run([program, *map(str, arguments)], check=False).returncode
    if code not in COMPLETE:
        sys.exit(f"{name} ended with exit code {code}")
    return code, time.monotonic() - began


def tune(seed: int, folder: Path, options: Iterable[str]) -> dict[str, float]:
    """Tune and certify; return how long it took."""
    _, tuning = command("tune", "--study", STUDY, "--seed", seed, "--output", folder, *options)
    _, certifying = command("validate", folder / "latest")
    return {"tuning_s": round(tuning, 1), "certifying_s": round(certifying, 1)}


def result(run: Path) -> dict[str, Any]:
    """Read what became of a run."""
    (node,) = yaml.safe_load((run / "best.yaml").read_text(encoding="utf-8")).values()
    summary = json.loads((run / "summary.json").read_text(encoding="utf-8"))
    certificates = [
        json.loads(path.read_text(encoding="utf-8"))
        for path in sorted((run / "certificates").glob("*.json"))
    ]
    return {
        "seed": yaml.safe_load((run / "study.yaml").read_text(encoding="utf-8"))["seed"],
        "trials": summary["trials"],
        "evaluations": summary["evaluations"],
        "gains": node["ros__parameters"],
        "feasible": summary["feasible"],
        "certificate": certificates[-1]["verdict"] if certificates else "none",
    }


def compare(gains: Gains, conditions: list[Conditions], executor: Executor) -> dict[str, Any]:
    """Judge gains in all conditions, and again with fresh noise where they overshoot most."""
    flights = judge_all(gains, conditions, executor)
    crashes = sum(flight.crashed for flight in flights)
    k = int(np.argmax([flight.overshoot for flight in flights]))
    repeats = [replace(conditions[k], seed=20_000 + i) for i in range(REPEATS)]
    worst = judge_all(gains, repeats, executor)
    return {
        "gains": dict(gains),
        "flights": len(flights),
        "crashes": crashes,
        **summary([flight for flight in flights if not flight.crashed]),
        "worst_condition": vars(conditions[k]),
        "overshoot_there": float(np.mean([flight.overshoot for flight in worst])),
    }


def summary(flights: list[Judgement]) -> dict[str, float]:
    """Summarize flights that did not crash: means, largest overshoot, 90 % quantile of effort."""
    return {
        "error": float(np.mean([flight.error for flight in flights])),
        "largest_overshoot": float(np.max([flight.overshoot for flight in flights])),
        "effort_90": float(np.percentile([flight.effort for flight in flights], 90.0)),
    }


def table(judged: Mapping[str, Mapping[str, Any]]) -> str:
    """Return the comparison as a table in Markdown."""
    rows = [
        "| gains | error [m] | overshoot in the worst condition, mean [%] | largest [%] "
        "| effort, 90 % quantile [rad/s] | crashes |",
        "|---|---|---|---|---|---|",
    ]
    for name, found in judged.items():
        rows.append(
            f"| {name} | {found['error']:.3f} | {found['overshoot_there']:.1f} "
            f"| {found['largest_overshoot']:.1f} | {found['effort_90']:.0f} "
            f"| {found['crashes']} of {found['flights']} |"
        )
    return "\n".join(rows)


def provenance() -> dict[str, str]:
    """Tell what produced the result."""
    described = subprocess.run(
        ["git", "describe", "--always", "--dirty", "--abbrev=12", "--exclude=*"],
        capture_output=True, text=True, check=False, cwd=HERE,
    )  # fmt: skip
    return {
        "commit": described.stdout.strip() or "unknown",
        "date": datetime.now().astimezone().isoformat(timespec="seconds"),
        "machine": f"{platform.machine()}, {platform.system()} {platform.release()}",
        "python": platform.python_version(),
    }


def main() -> None:
    """Run the campaign."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--seeds", type=int, nargs="+", default=[1], metavar="N")
    parser.add_argument("--runs", type=Path, nargs="+", metavar="RUN", help="judge these only")
    parser.add_argument("--output", type=Path, default=Path("runs"), metavar="DIR")
    parser.add_argument("--result", type=Path, metavar="FILE", help="JSON file of the comparison")
    parser.add_argument("--sparse", action="store_true", help="judge on a sparser grid")
    arguments, options = parser.parse_known_args()
    found = provenance()
    if arguments.runs:
        runs = [result(run) for run in arguments.runs]
    else:
        runs = []
        for seed in arguments.seeds:
            seconds = tune(seed, arguments.output, options)
            runs.append(result(arguments.output / "latest") | seconds)
    sets = {"default": DEFAULT, "Ziegler-Nichols": ziegler_nichols()}
    sets |= {f"tuned, seed {run['seed']}": run["gains"] for run in runs}
    conditions = grid(arguments.sparse)
    with ProcessPoolExecutor() as executor:
        judged = {name: compare(gains, conditions, executor) for name, gains in sets.items()}
    path = arguments.result or (arguments.output / "latest").resolve() / "comparison.json"
    path.write_text(json.dumps({**found, "runs": runs, "judged": judged}, indent=1) + "\n")
    print(table(judged), f"\nwritten to {path}", sep="\n")


if __name__ == "__main__":
    main()
