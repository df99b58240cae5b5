"""Where a hidden plant is by ten runs, whether a plant that no context explains is said, and drift.

The plant is the shipped axis in process, under the default parameters and others that differ much,
with five runs each; `--sets 1` makes ten with the default. Hidden ones are drawn inside of the
certified box and outside of it, in a wider box that is searched; their result is tuned in the
contexts that `identify` writes, and judged at the hidden plant beside that of a tuner that knows
the plant. Plants that no context explains have a longer dead time, another gain, or more noise. The
drift is of normal values, and of an axis that becomes stiffer.
"""

import os
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

# Before the libraries that read it.
os.environ.update(OPENBLAS_NUM_THREADS="1")

import numpy as np
from common import check_end, opened, provenance, result_parser, start_command, table, write_result

from bo_tuner.backends.inprocess import InProcessBackend
from bo_tuner.numerics.arrays import Array
from bo_tuner.numerics.rank_drift import RankTest
from bo_tuner.replay.identification import identify
from bo_tuner.replay.machine_runs import MachineRuns
from bo_tuner.storage.record import read_run
from bo_tuner.study.narrowing import narrowed
from bo_tuner.study.study import Study
from bo_tuner.study.study_file import (
    load_study,
    study_from_mapping,
    study_to_mapping,
    study_to_yaml,
)
from bo_tuner.trials import Evaluation, Stage, Value, parameter_set
from bo_tuner.tuning.driver import Driver

RUNS = 10
"""Runs of a hidden plant, at all its parameter sets."""
OTHER = {"control_horizon": 6, "lambda_mpc": -1.0}
"""The second parameter set: a shorter horizon, and calmer."""
WIDER = (0.5, 1.6)
"""Bounds of both contexts in the box that is searched; the certified ones are 0.7 to 1.3."""
JUDGED = 100
"""Runs at the hidden plant that judge a result."""
CREDIBLE, LEVEL = 0.99, 0.01
FALSE_ALARMS, MOST, BASELINE = 0.05, 20, 60
SHIFTS = (0.0, 0.5, 0.75, 1.0, 1.25)
"""Of normal values, in standard deviations."""
STIFFNESS = (1.0, 1.05, 1.1, 1.2)
"""Factors by which the axis becomes stiffer."""
POOL = 300
"""Runs of the axis at each stiffness, of which comparisons are drawn."""
COMPARISONS = 2000
UNEXPLAINED = {
    "dead time 40 ms, not 20": {"dead_time": 0.04},
    "gain 1.1, not 1": {"gain": 1.1},
    "noise variance doubled": {"noise_variance": 0.002},
}
SEED = 20_261_127


def machine_study(study: Study, plant: Mapping[str, float]) -> Study:
    """Return the study of a machine: without contexts, with these parameters of the plant."""
    mapping: Any = study_to_mapping(study)
    mapping["contexts"] = {}
    mapping["nodes"]["plant"]["parameters"] = dict(plant)
    return study_from_mapping(mapping)


def runs_of(
    study: Study, parameters: Mapping[str, Value], count: int, seed: int
) -> list[Mapping[str, float]]:
    """Return the metrics of runs of a machine; an empty mapping for one that failed."""
    with opened(InProcessBackend(study)) as backend:
        driver = Driver(backend)
        ran = [
            driver.evaluate(Evaluation(0, k, Stage.NOMINAL, parameters, {}, seed + k))
            for k in range(count)
        ]
    return [evaluation.outcome.metrics for evaluation in ran]


def box_of(study: Study, bounds: tuple[float, float]) -> Study:
    """Return the study with both contexts uniform between bounds."""
    mapping: Any = study_to_mapping(study)
    for name, item in mapping["contexts"].items():
        mapping["contexts"][name] = {
            "node": item["node"],
            "distribution": "uniform",
            "bounds": list(bounds),
        }
    return study_from_mapping(mapping)


def identified(study: Study, plant: Mapping[str, float], seed: int, count: int) -> dict[str, Any]:
    """Identify a hidden plant in the wider box, by runs at one or two parameter sets."""
    box, hidden_study = box_of(study, WIDER), machine_study(study, plant)
    sets = [study.search_space().defaults, study.complete_set(OTHER)][:count]
    runs = {
        parameter_set(each): runs_of(hidden_study, each, RUNS // count, seed + 50 * place)
        for place, each in enumerate(sets)
    }
    machine = MachineRuns(runs, tuple(study.of_plant), 0)
    with opened(InProcessBackend(box)) as simulator:
        result = identify(box, machine, Driver(simulator))
    narrower = narrowed(box, result.posterior.contexts, CREDIBLE)
    bounds = {n: (v.distribution.lower, v.distribution.upper) for n, v in narrower.contexts.items()}
    return {
        "plant": dict(plant),
        "misfits": result.misfits(LEVEL),
        "bounds": bounds,
        "within": all(low <= plant.get(name, 1.0) <= high for name, (low, high) in bounds.items()),
        "study": study_to_yaml(narrower),
    }


def hidden(count: int, rng: np.random.Generator) -> list[tuple[str, dict[str, float]]]:
    """Return plants in turn inside the certified box and outside of it, in the wider one."""
    names, plants = ("stiffness_factor", "damping_factor"), []
    for k in range(count):
        inside = k % 2 == 0
        while True:
            point = rng.uniform(*(0.75, 1.25) if inside else (0.6, 1.5), 2)
            if inside or not np.all((point >= 0.7) & (point <= 1.3)):
                break
        plants.append(
            ("inside" if inside else "outside", dict(zip(names, point.tolist(), strict=True)))
        )
    return plants


def all_plants(count: int, rng: np.random.Generator) -> Iterator[tuple[str, dict[str, float]]]:
    """Yield the hidden plants, then as many of each kind that no context explains."""
    yield from hidden(count, rng)
    for name, change in UNEXPLAINED.items():
        for _, plant in hidden(count, rng):
            yield name, plant | change


def tuned(text: str, plant_study: Study) -> dict[str, Any]:
    """Tune a study in process, and judge its result at the hidden plant."""
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "study.yaml").write_text(text, encoding="utf-8")
        command = start_command(
            Path(folder), "tune", "--backend", "inprocess", "--study", "study.yaml"
        )
        check_end(command.wait())
        record = read_run((Path(folder) / "runs" / "latest").resolve())
    if record.result is None:
        return {"feasible": False, "objective": None}
    runs = runs_of(plant_study, record.result.parameters, JUDGED, 90_000)
    kept = [
        np.mean([bool(run) and not limit.violations(run[limit.metric]) for run in runs])
        >= 1.0 - limit.allowed
        for limit in plant_study.constraints.values()
    ]
    return {
        "feasible": bool(all(kept)),
        "objective": float(np.mean([run["tracking_error"] for run in runs if run])),
    }


def drift_of_normal_values(metrics: int) -> list[list[object]]:
    """Return by shift in what share of comparisons it is found, one of several metrics shifted."""
    test, rng = RankTest(BASELINE, MOST, FALSE_ALARMS / metrics), np.random.default_rng(SEED)
    old = rng.standard_normal((COMPARISONS, metrics, BASELINE))
    new = rng.standard_normal((COMPARISONS, metrics, MOST))
    rows: list[list[object]] = []
    for shift in SHIFTS:
        moved = new.copy()
        moved[:, 0] += shift
        rows.append([metrics, shift, *found(test, old, moved)])
    return rows


def drift_of_axis(study: Study, pools: Mapping[float, Array], most: int) -> list[list[object]]:
    """Return by stiffness in what share it is found; pools (runs, metrics) of each stiffness."""
    metrics = len(study.of_plant)
    test, rng = RankTest(BASELINE, most, FALSE_ALARMS / metrics), np.random.default_rng(SEED)
    rows: list[list[object]] = []
    for factor, pool in pools.items():
        old, new = (
            np.empty((COMPARISONS, metrics, BASELINE)),
            np.empty((COMPARISONS, metrics, most)),
        )
        for k in range(COMPARISONS):
            order = rng.permutation(POOL)
            old[k] = pools[1.0][order[:BASELINE]].T
            new[k] = pool[order[BASELINE : BASELINE + most]].T
        rows.append([factor, most, *found(test, old, new)])
    return rows


def found(test: RankTest, old: Array, new: Array) -> tuple[float, float]:
    """Return the share of comparisons (c, metrics, n) with a drift, and the median number of runs.

    The median is of those in which it was found; 0 of none.
    """
    reached = (np.abs(test.statistics(old, new)) >= test.bound).any(axis=1)
    at = reached.any(axis=1)
    after = float(np.median(1 + np.argmax(reached[at], axis=1))) if at.any() else 0.0
    return float(at.mean()), after


def axis_pools(study: Study) -> dict[float, Array]:
    """Return the metrics (runs, metrics) of the axis by its stiffness."""
    default = study.search_space().defaults
    pools = {}
    for place, factor in enumerate(STIFFNESS):
        plant = machine_study(study, {"stiffness_factor": factor})
        runs = runs_of(plant, default, POOL, 1000 * (place + 1))
        pools[factor] = np.array([[run[name] for name in study.of_plant] for run in runs])
    return pools


def show_plants(plants: Sequence[Mapping[str, Any]]) -> None:
    """Show what became of the hidden plants, and of those that no context explains."""
    header = ["plant", "where", "within bounds", "misfit said", "feasible", "objective / known"]
    rows = []
    for item in plants:
        result, known = item.get("narrower"), item.get("known")
        solved = result and known and result["objective"] and known["objective"]
        ratio = result["objective"] / known["objective"] if solved else ""
        named = ", ".join(f"{value:.3g}" for value in item["plant"].values())
        feasible = "" if not result else result["feasible"]
        rows.append([named, item["where"], item["within"], bool(item["misfits"]), feasible, ratio])
    print(table(header, rows))


def main() -> None:
    """Identify, compare and report."""
    parser = result_parser(__doc__, "identify.json")
    parser.add_argument("--plants", type=int, default=10, help="hidden plants, and of each misfit")
    parser.add_argument("--sets", type=int, default=2, choices=(1, 2), help="parameter sets")
    parser.add_argument("--tuned", type=int, default=10, help="hidden plants that are tuned")
    arguments = parser.parse_args()
    study = load_study("benchmark")
    rng = np.random.default_rng(SEED)
    result: dict[str, Any] = {"provenance": provenance(), "runs": RUNS, "wider": WIDER}
    result["drift"] = [row for metrics in (1, 3) for row in drift_of_normal_values(metrics)]
    print(table(["metrics", "shift [sd]", "found", "median runs"], result["drift"]))
    pools = axis_pools(study)
    result["stiffness"] = [
        row for most in (MOST, 2 * MOST) for row in drift_of_axis(study, pools, most)
    ]
    print(table(["stiffness", "at most", "found", "median runs"], result["stiffness"]))
    plants: list[dict[str, Any]] = []
    result["plants"] = plants
    for k, (where, plant) in enumerate(all_plants(arguments.plants, rng)):
        plants.append({"where": where} | identified(study, plant, 10_000 + 100 * k, arguments.sets))
        write_result(arguments.result, result)
    show_plants(plants)
    for item in plants[: min(arguments.tuned, arguments.plants)]:
        if item["misfits"]:
            continue
        truth = machine_study(study, item["plant"])
        item["narrower"] = tuned(item["study"], truth)
        item["known"] = tuned(study_to_yaml(truth), truth)
        write_result(arguments.result, result)
    show_plants(plants)


if __name__ == "__main__":
    main()
