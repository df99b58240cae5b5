"""How the cost of a run grows with its trials and with the number of tuned parameters.

The study is in closed form, so that its evaluations cost next to nothing: a valley in d parameters,
whose worst case binds near the bottom. The cost is the processor time of the optimizer.
"""

import time
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from bo_tuner.methods.registry import METHODS
from bo_tuner.study.study import Study
from bo_tuner.study.study_file import study_from_mapping
from bo_tuner.tuning.driver import Driver
from bo_tuner.tuning.loop import Tuning
from tuning_benchmark.campaign.timed_backend import TimedBackend

INITIAL_TRIALS = 20


class Valley:
    """A node in closed form: metrics ``error`` and ``peak`` of gains in the unit interval."""

    def __init__(self) -> None:
        self._values: dict[str, float] = {}

    def set_parameters(self, values: Mapping[str, float]) -> None:
        """Take some of the gains, the load and the seed."""
        self._values |= values

    def run_cut(self) -> dict[str, object]:
        """Evaluate the metrics with noise from the seed."""
        gains = np.array([v for name, v in sorted(self._values.items()) if name[0] == "g"])
        load = self._values["load"]
        noise = np.random.default_rng(int(self._values["seed"])).normal(0.0, 0.01, 2)
        error = 0.1 + float(np.mean((gains - 0.7) ** 2)) * load + abs(noise[0])
        peak = float(gains.mean()) * load + noise[1]
        return {"status": "ok", "reason": "", "error": error, "peak": peak}


def valley(dimension: int, seed: int, trials: int) -> Study:
    """Study of the valley in `dimension` gains."""
    node = {"node": "valley"}
    gains = {f"g{i}": node | {"type": "double", "bounds": [0.0, 1.0]} for i in range(dimension)}
    return study_from_mapping(
        {
            "name": f"valley{dimension}",
            "nodes": {"valley": node | {"result": "~/cut_result", "object": f"{__name__}:Valley"}},
            "parameters": {name: item | {"default": 0.5} for name, item in gains.items()},
            "contexts": {"load": node | {"distribution": "uniform", "bounds": [0.8, 1.2]}},
            "seed_parameter": node | {"parameter": "seed"},
            "trigger": node | {"service": "~/run_cut"},
            "metrics": {"error": node, "peak": node},
            "objective": {"metric": "error", "scale": "log"},
            "constraints": {"peak": {"kind": "worst_case", "metric": "peak", "upper": 0.75}},
            "budget": {"trials": trials, "initial_trials": min(INITIAL_TRIALS, trials)},
            "seed": seed,
        }
    )


def cost_of_run(algorithm: str, dimension: int, seed: int, marks: Sequence[int]) -> dict[str, Any]:
    """Processor time [s] of the optimizer, without evaluations, until each mark of trials.

    Returns
    -------
    dict
        ``trials``, the marks, and ``seconds`` at each.
    """
    study = valley(dimension, seed, max(marks))
    backend = TimedBackend(study)
    backend.open()
    seconds = []
    begin = time.process_time()
    for trial in Tuning(study, Driver(backend), METHODS[algorithm]):
        if trial.number + 1 in marks:
            seconds.append(round(time.process_time() - begin - backend.seconds, 3))
    return {"trials": sorted(marks), "seconds": seconds}
