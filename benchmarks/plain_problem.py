"""The plain problem: functions without contexts and noise, with and without limits.

Functions of the BBOB test suites (Hansen and others 2009), plain and constrained, from
`coco-experiment`; an instance takes the place of a seed. `boundary` is told that they are free of
noise, and so is Optuna's GPSampler. Every optimizer begins with the initial design that ``init``
gives a study of that many parameters, and has as many evaluations; what counts is the lowest value
seen that keeps all limits. Of the median over the instances each function ranks the optimizers.
One thread; times are those of the processor, of all proposals of a run. The record is written after
each instance, and says how many there were.

References
----------
Hansen, Auger, Ros, Mersmann, Tušar and Brockhoff (2021). COCO: a platform for comparing continuous
optimizers in a black-box setting. Optimization Methods and Software 36(1).
Hansen, Finck, Ros and Auger (2009). Real-parameter black-box optimization benchmarking 2009:
noiseless functions definitions. INRIA RR-6829.
"""

import importlib.util
import os
import statistics
import time
import warnings
from collections.abc import Mapping
from typing import Any

# Before the libraries that read them.
os.environ.update(OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1", MKL_NUM_THREADS="1")

import numpy as np
from common import OTHER_PACKAGES, opened, provenance, result_parser, table, write_result
from scipy.stats import rankdata

import bo_tuner as bt
from bo_tuner.backends.function import FunctionBackend
from bo_tuner.methods.protocol import Method
from bo_tuner.methods.registry import METHODS
from bo_tuner.study.sizing import first_budget
from bo_tuner.study.study import Study
from bo_tuner.tuning.driver import Driver
from bo_tuner.tuning.loop import Tuning
from bo_tuner.tuning.observer import NOBODY
from tuning_benchmark.experiments.plugins import load
from tuning_benchmark.peers.adapter import PeerOptimizer, peer_method

SUITE_PACKAGE = "coco-experiment"
OWN = "boundary"
PEERS = {
    "Optuna GP": ("optuna", "tuning_benchmark.peers.optuna_samplers:OptunaGP"),
    "Optuna TPE": ("optuna", "tuning_benchmark.peers.optuna_samplers:OptunaTPE"),
    "CMA-ES": ("cma", "tuning_benchmark.peers.cma_es:CmaEs"),
    "BoTorch": ("botorch", "tuning_benchmark.peers.botorch_lognei:BoTorch"),
    "SMAC": ("smac", "tuning_benchmark.peers.smac_blackbox:Smac"),
}
"""Of each other optimizer the package that it needs, and its class."""

PLAIN, LIMITED = "plain", "with limits"
SUITES = {
    PLAIN: ("bbob", (1, 2, 3, 6, 7, 8, 11, 12, 13, 14, 17, 21)),
    LIMITED: ("bbob-constrained", (2, 8, 26, 44)),
}
"""Of each kind of problem the suite, and its functions; those with limits have three of them."""


class Problem:
    """A function of a suite, which writes down the best that it was asked.

    Attributes
    ----------
    study
        The study.
    calls
        How often it was asked.
    best
        The lowest value that keeps all limits; infinite if there is none.
    seconds
        Processor's time of its own [s].
    """

    def __init__(
        self, suite: str, function: int, dimension: int, instance: int, evaluations: int
    ) -> None:
        # A problem lives as long as its suite.
        self._suite = importlib.import_module("cocoex").Suite(suite, "", "")
        self._problem = self._suite.get_problem_by_function_dimension_instance(
            function, dimension, instance
        )
        limits = [f"limit_{k}" for k in range(self._problem.number_of_constraints)]
        budget = first_budget(dimension, contexts=False, limits_runs=False)
        self.study: Study = bt.Study(
            name="plain",
            parameters={f"x{k}": bt.Double(-5.0, 5.0, default=0.0) for k in range(dimension)},
            metrics=["value", *limits],
            objective="value",
            constraints={name: bt.WorstCase(name, upper=0.0) for name in limits},
            noise="none",
            budget=bt.Budget(
                trials=evaluations,
                initial_trials=budget["initial_trials"],
                evaluations=evaluations,
            ),
            seed=instance,
        ).checked
        self.calls, self.best, self.seconds = 0, np.inf, 0.0

    def __call__(
        self, parameters: Mapping[str, Any], context: Mapping[str, Any], seed: int
    ) -> dict[str, float]:
        """Return its value, and how far it is beyond each limit."""
        begin = time.process_time()
        x = np.array([parameters[f"x{k}"] for k in range(self._problem.dimension)])
        beyond = self._problem.constraint(x) if self._problem.number_of_constraints else ()
        value = float(self._problem(x))
        if all(each <= 0.0 for each in beyond):
            self.best = min(self.best, value)
        self.calls += 1
        self.seconds += time.process_time() - begin
        limits = {f"limit_{k}": float(each) for k, each in enumerate(beyond)}
        return {"value": value} | limits


def run(problem: Problem, optimizer: str) -> dict[str, Any]:
    """Have an optimizer run its trials, and return the best value and the time [s]."""
    study = problem.study
    method: Method = METHODS[OWN]
    if optimizer != OWN:
        method = peer_method(PeerOptimizer(study, load(PEERS[optimizer][1])(study, study.seed)))
    begin = time.process_time()
    with opened(FunctionBackend(study, problem)) as backend:
        for _ in Tuning(study, Driver(backend, NOBODY), method):
            pass
    return {
        "instance": study.seed,
        "best": problem.best if np.isfinite(problem.best) else None,
        "evaluations": problem.calls,
        "seconds": round(time.process_time() - begin - problem.seconds, 2),
    }


def present() -> list[str]:
    """Return the optimizers whose package is installed, and say which are not."""
    absent = [name for name, (needs, _) in PEERS.items() if importlib.util.find_spec(needs) is None]
    for name in absent:
        print(f"{name} is left out: {PEERS[name][0]} is not installed")
    return [OWN, *(name for name in PEERS if name not in absent)]


def ranks(found: Mapping[str, list[dict[str, Any]]]) -> dict[str, float]:
    """Rank the optimizers of a function by their median best value; equal ones share a rank."""
    medians = [
        statistics.median(np.inf if r["best"] is None else r["best"] for r in results)
        for results in found.values()
    ]
    return dict(zip(found, rankdata(medians).tolist(), strict=True))


def summary(functions: Mapping[str, Mapping[str, Any]]) -> dict[str, dict[str, Any]]:
    """Return of each optimizer its ranks over the functions of a group, and its time."""
    of_each = [entry["ranks"] for entry in functions.values()]
    return {
        name: {
            "mean rank": statistics.mean(each[name] for each in of_each),
            "median rank": statistics.median(each[name] for each in of_each),
            "first": sum(each[name] == min(each.values()) for each in of_each),
            "seconds": statistics.median(
                r["seconds"] for entry in functions.values() for r in entry["results"][name]
            ),
        }
        for name in of_each[0]
    }


def main() -> None:
    """Run all optimizers on all functions and report."""
    parser = result_parser(__doc__, "plain_problem.json")
    parser.add_argument("--kinds", nargs="+", choices=SUITES, default=list(SUITES))
    parser.add_argument("--functions", type=int, nargs="+", help="(default: all)")
    parser.add_argument("--dimensions", type=int, nargs="+", default=[2, 5])
    parser.add_argument("--instances", type=int, default=3, help="(default: %(default)s)")
    parser.add_argument("--evaluations", type=int, default=50, help="(default: %(default)s)")
    arguments = parser.parse_args()
    if importlib.util.find_spec("cocoex") is None:
        raise SystemExit(f"error: the functions are those of {SUITE_PACKAGE}; pip install it")
    warnings.simplefilter("ignore")
    optimizers = present()
    packages = [PEERS[name][0] for name in optimizers if name != OWN]
    result: dict[str, Any] = {
        "provenance": provenance((*OTHER_PACKAGES, SUITE_PACKAGE, *dict.fromkeys(packages))),
        "evaluations": arguments.evaluations,
        "groups": {},
    }
    groups = result["groups"]
    for instance in range(1, arguments.instances + 1):
        for kind in arguments.kinds:
            suite, functions = SUITES[kind]
            for dimension in arguments.dimensions:
                group = groups.setdefault(f"{kind}, {dimension}D", {"functions": {}})
                for function in arguments.functions or functions:
                    entry = group["functions"].setdefault(
                        f"f{function}", {"results": {name: [] for name in optimizers}}
                    )
                    for name in optimizers:
                        problem = Problem(
                            suite, function, dimension, instance, arguments.evaluations
                        )
                        entry["results"][name].append(run(problem, name))
                    entry["ranks"] = ranks(entry["results"])
                    print(kind, dimension, function, instance, entry["ranks"], flush=True)
                group["summary"] = summary(group["functions"])
        write_result(arguments.result, result | {"instances": instance})
    rows = [
        [group, name, *found.values()]
        for group, entry in groups.items()
        for name, found in entry["summary"].items()
    ]
    print(table(["group", "optimizer", "mean rank", "median rank", "first", "time [s]"], rows))


if __name__ == "__main__":
    main()
