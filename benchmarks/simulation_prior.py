"""What a simulation's run is worth on the machine: `tune --from RUN --simulated`.

The benchmark axis is tuned once in simulation, over its box of contexts. Machines are hidden plants
inside of the box, outside of it, and such that no context explains: each is tuned with few trials,
without and with the trials of the simulation. Both results are judged by further runs.
"""

import argparse
import os
import tempfile
from collections.abc import Mapping
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

# Before the libraries that read it.
os.environ.update(OPENBLAS_NUM_THREADS="1")

import numpy as np
from common import check_end, opened, provenance, result_parser, start_command, table, write_result
from identify import machine_study, runs_of

from bo_tuner.backends.inprocess import InProcessBackend
from bo_tuner.method_names import DEFAULT_METHOD
from bo_tuner.methods.registry import METHODS
from bo_tuner.storage.record import RunRecord, read_run
from bo_tuner.study.limits import broken_limits
from bo_tuner.study.study import Study
from bo_tuner.study.study_file import load_study, study_to_yaml
from bo_tuner.tuning.driver import Driver
from bo_tuner.tuning.loop import Tuning
from bo_tuner.tuning.simulated_runs import begun_by_simulation, take_simulation
from bo_tuner.tuning.summary import choose_answer

TRIALS = 12
"""Of the machine."""
JUDGED = 400
"""Runs at the hidden plant that judge a result."""
PLANTS: dict[str, dict[str, float]] = {
    "softer, inside the box": {"stiffness_factor": 0.75, "damping_factor": 1.2},
    "stiffer, outside the box": {"stiffness_factor": 1.4, "damping_factor": 0.8},
    "dead time 40 ms, not 20": {"dead_time": 0.04},
    "gain 1.1, not 1": {"gain": 1.1},
}


def simulate() -> tempfile.TemporaryDirectory[str]:
    """Tune the benchmark study in simulation; its run is in ``runs/latest`` of the folder."""
    folder = tempfile.TemporaryDirectory()
    path = Path(folder.name)
    (path / "study.yaml").write_text(study_to_yaml(load_study("benchmark")), encoding="utf-8")
    command = start_command(path, "tune", "--backend", "inprocess", "--study", "study.yaml")
    check_end(command.wait())
    return folder


def tuned(record: RunRecord, plant: str, seed: int, knowing: bool) -> dict[str, Any]:
    """Tune a machine, and judge its result."""
    machine = machine_study(load_study("benchmark"), PLANTS[plant])
    study, method = machine.replace(trials=TRIALS, seed=seed), METHODS[DEFAULT_METHOD]
    if knowing:
        known = take_simulation(record, study, method)
        study = begun_by_simulation(study, record, known)
        method = method.knowing(study, known.trials)
    with opened(InProcessBackend(study)) as backend:
        driver = Driver(backend)
        tuning = Tuning(study, driver, method)
        list(tuning)
        answer = choose_answer(study, driver, method, tuning.trials)
    broken = [any(broken_limits(study, e.outcome) for e in t.evaluations) for t in tuning.trials]
    parameters = None if answer is None else answer.candidate.trial.parameters
    runs = [] if parameters is None else runs_of(study, parameters, JUDGED, 90_000)
    return {
        "plant": plant,
        "seed": seed,
        "knowing": knowing,
        "broken": sum(broken),
        "believed": answer is not None and answer.feasible,
        "feasible": is_feasible(study, runs),
        "objective": mean_error(runs),
    }


def is_feasible(study: Study, runs: list[Mapping[str, float]]) -> bool:
    """Return whether the runs keep each limit as often as it asks for."""
    return bool(runs) and all(
        np.mean([bool(run) and not limit.violations(run[limit.metric]) for run in runs])
        >= 1.0 - limit.allowed
        for limit in study.constraints.values()
    )


def mean_error(runs: list[Mapping[str, float]]) -> float | None:
    """Return the mean objective of the runs that did not fail."""
    errors = [run["tracking_error"] for run in runs if run]
    return float(np.mean(errors)) if errors else None


def show(rows: list[dict[str, Any]]) -> None:
    """Print what each machine came to."""
    print(
        table(
            ["plant", "simulation", "feasible", "median objective", "trials broken"],
            [
                [
                    plant,
                    "known" if knowing else "unknown",
                    f"{sum(r['feasible'] for r in own)} of {len(own)}",
                    float(np.median([r["objective"] for r in own])),
                    f"{sum(r['broken'] for r in own)} of {len(own) * TRIALS}",
                ]
                for plant in PLANTS
                for knowing in (False, True)
                if (own := [r for r in rows if (r["plant"], r["knowing"]) == (plant, knowing)])
            ],
        )
    )


def main() -> None:
    """Tune all machines, and write the result."""
    parser = result_parser(__doc__, "simulation_prior.json")
    parser.add_argument("--runs", type=int, default=5, help="seeds of each machine (default: 5)")
    parser.add_argument("--jobs", type=int, default=1, help="machines at once (default: 1)")
    arguments: argparse.Namespace = parser.parse_args()
    rows: list[dict[str, Any]] = []
    result = {"provenance": provenance(), "trials": TRIALS, "rows": rows}
    with simulate() as folder, ProcessPoolExecutor(arguments.jobs) as pool:
        record = read_run((Path(folder) / "runs" / "latest").resolve())
        waiting = [
            pool.submit(tuned, record, plant, seed, knowing)
            for plant in PLANTS
            for seed in range(1, arguments.runs + 1)
            for knowing in (False, True)
        ]
        for each in waiting:
            rows.append(each.result())
            write_result(arguments.result, result)
    show(rows)


if __name__ == "__main__":
    main()
