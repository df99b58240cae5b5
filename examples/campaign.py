"""Tunes an example, once for each seed, and judges the results against default and classical rule.

For each seed it calls `tune` and `validate` as a user would. Then it judges the default, the gains
of Ziegler and Nichols, the best of them times factors at as many flights, and each result, and
writes all of it to one JSON file with commit, seeds, machine and times. An example is a folder with
`study.yaml` and two modules: `judge` (DEFAULT, judge, grid, draws) and `classical` (LOOPS,
ziegler_nichols, detuned). Run it from the root of the repository.
"""

import argparse
import importlib
import json
import platform
import subprocess
import sys
import time
from collections.abc import Iterable
from concurrent.futures import ProcessPoolExecutor
from datetime import datetime
from pathlib import Path
from typing import Any

import yaml
from comparison import Comparison, seeds_table, table
from detuning import detune, hardest

COMPLETE = (0, 3)
"""Exit codes of `tune` and `validate` that do not mean that something went wrong."""
DRAWS = 64  # of the conditions, for the expected objective
TRIED = 3
"""Drawn conditions in which the classical rule is tried with other factors, fresh ones a seed."""


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
    study = yaml.safe_load((run / "study.yaml").read_text(encoding="utf-8"))
    return {
        "seed": study["seed"],
        "trials": summary["trials"],
        "evaluations": summary["evaluations"],
        # Not what the study sets once, such as the Cessna's rate.
        "gains": {name: node["ros__parameters"][name] for name in study["parameters"]},
        "feasible": summary["feasible"],
        "certificate": certificates[-1]["verdict"] if certificates else "none",
    }


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
    parser.add_argument(
        "--rivals", type=int, metavar="N", help="try the classical rule beside so many runs only"
    )
    arguments, options = parser.parse_known_args()
    if len(set(arguments.seeds)) < len(arguments.seeds):
        parser.error("--seeds: expected different ones")
    folder = Path(__file__).parent / arguments.example
    if not (folder / "study.yaml").is_file() or not (folder / "judge.py").is_file():
        parser.error(f"{arguments.example}: expected a folder with study.yaml and judge.py")
    sys.path.insert(0, str(folder))
    judge, classical = map(importlib.import_module, ("judge", "classical"))
    found = provenance()
    runs = [result(run) for run in arguments.runs or ()]
    if len({run["seed"] for run in runs}) < len(runs):
        parser.error("--runs: expected runs with different seeds, by which they are told apart")
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
        hard = hardest(compare, judge.DEFAULT) if runs else []
        for run in runs[: arguments.rivals]:
            gains = detune(
                classical.detuned, len(classical.LOOPS), compare, hard,
                judge.draws(TRIED, run["seed"]), run["evaluations"], run["seed"],
            )  # fmt: skip
            if gains is not None:
                sets[f"Ziegler-Nichols detuned, seed {run['seed']}"] = gains
        judged = {name: compare(gains) for name, gains in sets.items()}
    path = arguments.result or (arguments.output / "latest").resolve() / "comparison.json"
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps({**found, "runs": runs, "judged": judged}, indent=1) + "\n")
    print(table(judged, study))
    if runs:
        print("", seeds_table(runs, judged, study), sep="\n")
    print(f"\nwritten to {path}")


if __name__ == "__main__":
    main()
