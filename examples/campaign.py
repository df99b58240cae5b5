"""Tunes an example, once for each seed, and judges the results against default and classical rule.

For each seed it calls `tune` and `validate` as a user would. Then it judges the default, the gains
of Ziegler and Nichols and each result, and writes all of it to one JSON file with commit, seeds,
machine and times. An example is a folder with `study.yaml` and two modules: `judge` (DEFAULT,
judge, grid, draws) and `classical` (ziegler_nichols). Run it from the root of the repository.
"""

import argparse
import importlib
import json
import platform
import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import Executor, ProcessPoolExecutor
from dataclasses import dataclass, replace
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
import yaml

COMPLETE = (0, 3)
"""Exit codes of `tune` and `validate` that do not mean that something went wrong."""
DRAWS = 64  # of the conditions, for the expected objective
WORST, REPEATS = 3, 5
"""How many of the worst conditions of the grid are flown again, and how often with fresh noise."""


def command(name: str, *arguments: object) -> tuple[int, float]:
    """Run a command of the tuner; return its exit code and how long it took [s]."""
    began = time.monotonic()
    program = Path(sys.executable).parent / name
    code = subprocess.run([program, *map(str, arguments)], check=False).returncode
    if code not in COMPLETE:
        sys.exit(f"{name} ended with exit code {code}")
    return code, time.monotonic() - began


def tune(study: Path, seed: int, folder: Path, options: Iterable[str]) -> dict[str, float]:
    """Tune and certify; return how long it took."""
    _, tuning = command("tune", "--study", study, "--seed", seed, "--output", folder, *options)
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


@dataclass(frozen=True)
class Comparison:
    """Judges sets of gains, all in the same conditions.

    Attributes
    ----------
    judge : callable
        From gains and conditions to what became of a flight: a number for each metric, `crashed`.
    grid, draws : list
        Conditions for the worst case and for the expected values.
    study : mapping
        Objective and limits.
    executor
        Flies.
    """

    judge: Callable[[Mapping[str, float], Any], Any]
    grid: list[Any]
    draws: list[Any]
    study: Mapping[str, Any]
    executor: Executor

    def limits(self, kind: str) -> dict[str, Mapping[str, Any]]:
        """Return the constraints of a kind by the name of their metric."""
        return {c["metric"]: c for c in self.study["constraints"].values() if c["kind"] == kind}

    def fly(self, gains: Mapping[str, float], conditions: list[Any]) -> list[Any]:
        """Return what became of a flight in each of the conditions."""
        return list(
            self.executor.map(self.judge, [gains] * len(conditions), conditions, chunksize=4)
        )

    def __call__(self, gains: Mapping[str, float]) -> dict[str, Any]:
        """Judge gains: crashes, means of flights that did not crash, limits."""
        drawn = self.fly(gains, self.draws)
        flown = [flight for flight in drawn if not flight.crashed]
        over_grid = self.fly(gains, self.grid)
        found: dict[str, Any] = {
            "gains": dict(gains),
            "flights": len(drawn) + len(over_grid),
            "crashes": sum(flight.crashed for flight in drawn + over_grid),
        }
        objective = self.study["objective"]["metric"]
        if flown:
            found[objective] = float(np.mean([getattr(flight, objective) for flight in flown]))
        for metric, limit in self.limits("chance").items():
            within = [not f.crashed and getattr(f, metric) <= limit["upper"] for f in drawn]
            found[f"{metric}_within"] = float(np.mean(within))
        for metric in self.limits("worst_case"):
            found["worst"] = self.worst(gains, metric, over_grid)
        return found

    def worst(
        self, gains: Mapping[str, float], metric: str, over_grid: list[Any]
    ) -> dict[str, Any]:
        """Return the worst mean of a metric, and where: a crash counts as worse than any number."""
        values = np.array([np.inf if f.crashed else getattr(f, metric) for f in over_grid])
        means = []
        for k in np.argsort(-values, kind="stable")[:WORST]:
            repeats = [replace(self.grid[k], seed=20_000 + i) for i in range(REPEATS)]
            again = self.fly(gains, repeats)
            if values[k] == np.inf or any(flight.crashed for flight in again):
                return {"mean": None, "conditions": vars(self.grid[k])}
            means.append((float(np.mean([getattr(f, metric) for f in again])), int(k)))
        mean, k = max(means)
        return {"mean": mean, "conditions": vars(self.grid[k]), "single": float(values.max())}


def table(judged: Mapping[str, Mapping[str, Any]], study: Mapping[str, Any]) -> str:
    """Return the comparison as a table in Markdown."""
    objective = study["objective"]["metric"]
    constraints = study["constraints"].values()
    (worst,) = (c for c in constraints if c["kind"] == "worst_case")
    chance = [c for c in constraints if c["kind"] == "chance"]
    columns = [
        "gains", f"mean {objective}", "to the default",
        f"worst {worst['metric']} (limit {worst['upper']:g})",
        *(f"{c['metric']} within {c['upper']:g} (at least {c['probability']:.0%})" for c in chance),
        "crashes",
    ]  # fmt: skip
    rows = [columns, ["---"] * len(columns)]
    for name, found in judged.items():
        mean, largest = found.get(objective), found["worst"]["mean"]
        change = None if mean is None else mean / judged["default"][objective] - 1.0
        row = [
            name,
            "" if mean is None else f"{mean:.3f}",
            "" if change is None else f"{change:+.1%}",
            "crash" if largest is None else f"{largest:.1f}",
            *(f"{found[c['metric'] + '_within']:.0%}" for c in chance),
            f"{found['crashes']} of {found['flights']}",
        ]
        rows.append(row)
    return "\n".join("| " + " | ".join(row) + " |" for row in rows)


def provenance() -> dict[str, str]:
    """Tell what produced the result."""
    described = subprocess.run(
        ["git", "describe", "--always", "--dirty", "--abbrev=12", "--exclude=*"],
        capture_output=True, text=True, check=False, cwd=Path(__file__).parent,
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
    parser.add_argument("example", help="folder beside this file")
    parser.add_argument("--seeds", type=int, nargs="+", default=[1], metavar="N")
    parser.add_argument("--runs", type=Path, nargs="+", metavar="RUN", help="judge these only")
    parser.add_argument(
        "--gains", type=Path, nargs="+", metavar="FILE", help="judge these values by name, only"
    )
    parser.add_argument("--output", type=Path, default=Path("runs"), metavar="DIR")
    parser.add_argument("--result", type=Path, metavar="FILE", help="JSON file of the comparison")
    parser.add_argument("--sparse", action="store_true", help="judge on a sparser grid")
    arguments, options = parser.parse_known_args()
    folder = Path(__file__).parent / arguments.example
    if not (folder / "study.yaml").is_file() or not (folder / "judge.py").is_file():
        parser.error(f"{arguments.example}: expected a folder with study.yaml and judge.py")
    sys.path.insert(0, str(folder))
    judge, classical = map(importlib.import_module, ("judge", "classical"))
    found = provenance()
    runs = [result(run) for run in arguments.runs or ()]
    if not arguments.runs and not arguments.gains:
        for seed in arguments.seeds:
            seconds = tune(folder / "study.yaml", seed, arguments.output, options)
            runs.append(result(arguments.output / "latest") | seconds)
    sets = {"default": judge.DEFAULT} | classical.ziegler_nichols()
    sets |= {f"tuned, seed {run['seed']}": run["gains"] for run in runs}
    sets |= {
        path.stem: yaml.safe_load(path.read_text(encoding="utf-8"))
        for path in arguments.gains or ()
    }
    study = yaml.safe_load((folder / "study.yaml").read_text(encoding="utf-8"))
    with ProcessPoolExecutor() as executor:
        compare = Comparison(
            judge.judge, judge.grid(arguments.sparse), judge.draws(DRAWS), study, executor
        )
        judged = {name: compare(gains) for name, gains in sets.items()}
    path = arguments.result or (arguments.output / "latest").resolve() / "comparison.json"
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps({**found, "runs": runs, "judged": judged}, indent=1) + "\n")
    print(table(judged, study), f"\nwritten to {path}", sep="\n")


if __name__ == "__main__":
    main()
