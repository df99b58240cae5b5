"""The plain problem: functions without contexts, with and without noise and limits.

Functions of the BBOB test suites (Hansen and others 2009), plain and constrained, from
`coco-experiment`; an instance takes the place of a seed. Noise is normal, its standard deviation a
share of the function's interquartile range. Every optimizer begins with the initial design that
``init`` gives a study of that many parameters, and has as many evaluations. Without noise all that
can be told so are told so, and what counts is the lowest value seen that keeps all limits; with
noise it is the value, free of noise, of what the optimizer recommends. On each problem, a function
and an instance, the optimizers are ranked. One thread; times are those of the processor, of all
proposals of a run. Results are added to the record, which has each with its commit, so that a
long record can be made in parts; `--also` adds those of other files.

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
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

# Before the libraries that read them.
os.environ.update(OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1", MKL_NUM_THREADS="1")

import numpy as np
from common import (
    OTHER_PACKAGES,
    opened,
    provenance,
    read_result,
    result_parser,
    table,
    write_result,
)
from scipy.stats import qmc, rankdata

import bo_tuner as bt
from bo_tuner.backends.function import FunctionBackend
from bo_tuner.methods.protocol import Method
from bo_tuner.methods.registry import METHODS
from bo_tuner.numerics.arrays import Array
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

PLAIN, NOISY, LIMITED = "plain", "noisy", "with limits"
DOZEN = (1, 2, 3, 6, 7, 8, 11, 12, 13, 14, 17, 21)
SUITES = {
    PLAIN: ("bbob", DOZEN),
    NOISY: ("bbob", DOZEN),
    LIMITED: ("bbob-constrained", (2, 8, 26, 44)),
}
"""Of each kind of problem the suite, and its functions; those with limits have three of them."""

NOISE = 0.05
"""Standard deviation of the noise, as a share of the interquartile range of the function."""
SAMPLE = 1024
"""Points by which that range is known, a power of two."""

Key = tuple[str, int, int, int, int, str]
"""Kind, dimension, evaluations, function, instance, optimizer: there is one result of each."""


class Problem:
    """A function of a suite, which writes down the best that it was asked.

    Attributes
    ----------
    study
        The study.
    calls
        How often it was asked.
    best
        The lowest value, free of noise, that keeps all limits; infinite if there is none.
    seconds
        Processor's time of its own [s].
    """

    def __init__(
        self, kind: str, dimension: int, evaluations: int, function: int, instance: int
    ) -> None:
        # A problem lives as long as its suite.
        self._suite = importlib.import_module("cocoex").Suite(
            SUITES[kind][0], f"instances: {instance}", ""
        )
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
            noise="random" if kind == NOISY else "none",
            budget=bt.Budget(
                trials=evaluations,
                initial_trials=budget["initial_trials"],
                drawn_contexts=budget["drawn_contexts"],
                evaluations=evaluations,
            ),
            seed=instance,
        ).checked
        self.calls, self.best, self.seconds = 0, np.inf, 0.0
        self._noise = self._spread() * NOISE if kind == NOISY else 0.0
        self._rng = np.random.default_rng(instance)

    def __call__(
        self, parameters: Mapping[str, Any], context: Mapping[str, Any], seed: int
    ) -> dict[str, float]:
        """Return its value, and how far it is beyond each limit."""
        begin = time.process_time()
        x = self._point(parameters)
        beyond = self._problem.constraint(x) if self._problem.number_of_constraints else ()
        value = float(self._problem(x))
        if all(each <= 0.0 for each in beyond):
            self.best = min(self.best, value)
        self.calls += 1
        self.seconds += time.process_time() - begin
        limits = {f"limit_{k}": float(each) for k, each in enumerate(beyond)}
        return {"value": value + self._noise * self._rng.standard_normal()} | limits

    def value_of(self, parameters: Mapping[str, Any] | None) -> float:
        """Return the value, free of noise, of a parameter set; infinite without one."""
        if parameters is None:
            return np.inf
        return float(self._problem(self._point(parameters)))

    def _point(self, parameters: Mapping[str, Any]) -> Array:
        return np.array([parameters[f"x{k}"] for k in range(self._problem.dimension)])

    def _spread(self) -> float:
        """Return the interquartile range over the search space."""
        sobol = qmc.Sobol(self._problem.dimension, rng=0)
        values = [self._problem(x) for x in qmc.scale(sobol.random(SAMPLE), -5.0, 5.0)]
        lower, upper = np.quantile(values, [0.25, 0.75])
        return float(upper - lower)


def run(key: Key) -> dict[str, Any]:
    """Have an optimizer run its trials, and return the value that counts and the time [s]."""
    kind, dimension, evaluations, function, instance, optimizer = key
    problem = Problem(kind, dimension, evaluations, function, instance)
    study = problem.study
    method: Method = METHODS[OWN]
    peer = None
    if optimizer != OWN:
        peer = PeerOptimizer(study, load(PEERS[optimizer][1])(study, study.seed))
        method = peer_method(peer)
    begin = time.process_time()
    with opened(FunctionBackend(study, problem)) as backend:
        tuning = Tuning(study, Driver(backend, NOBODY), method)
        for _ in tuning:
            pass
    seconds = time.process_time() - begin - problem.seconds
    found = problem.best
    if not study.is_noiseless:
        if peer is not None:
            number = peer.recommend()
        else:
            incumbent = method.incumbent(study, tuning.trials)
            number = None if incumbent is None else incumbent.trial.number
        found = problem.value_of(None if number is None else tuning.trials[number].parameters)
    return {
        "found": found if np.isfinite(found) else None,
        "evaluations used": problem.calls,
        "seconds": round(seconds, 2),
    }


def present() -> list[str]:
    """Return the optimizers whose package is installed, and say which are not."""
    absent = [name for name, (needs, _) in PEERS.items() if importlib.util.find_spec(needs) is None]
    for name in absent:
        print(f"{name} is left out: {PEERS[name][0]} is not installed")
    return [OWN, *(name for name in PEERS if name not in absent)]


COLUMNS = ("kind", "dimension", "evaluations", "function", "instance", "optimizer")
"""Of a result, what its key consists of."""


def known(files: Iterable[Path]) -> dict[Key, dict[str, Any]]:
    """Read the results of records; of two the later file's counts."""
    records = [record for path in files if (record := read_result(path)) is not None]
    return {tuple(r[name] for name in COLUMNS): r for record in records for r in record["runs"]}


def summary(runs: Iterable[Mapping[str, Any]]) -> dict[str, dict[str, Any]]:
    """Return of each group the optimizers' ranks, over the problems that all have done.

    Equal values share a rank. A function's entry is the mean rank of each optimizer there.
    """
    groups: dict[str, dict[tuple[int, int], dict[str, Mapping[str, Any]]]] = {}
    for each in runs:
        group = f"{each['kind']}, {each['dimension']}D, {each['evaluations']}"
        problem = groups.setdefault(group, {}).setdefault((each["function"], each["instance"]), {})
        problem[each["optimizer"]] = each
    return {group: _summed_up(problems) for group, problems in groups.items()}


def _summed_up(
    problems: Mapping[tuple[int, int], Mapping[str, Mapping[str, Any]]],
) -> dict[str, Any]:
    names = {name for found in problems.values() for name in found}
    optimizers = [name for name in (OWN, *PEERS) if name in names]
    by_all = {problem: found for problem, found in problems.items() if len(found) == len(names)}
    ranks: dict[tuple[int, int], dict[str, float]] = {}
    for problem, found in by_all.items():
        values = [found[name]["found"] for name in optimizers]
        ranked = rankdata([np.inf if value is None else value for value in values])
        ranks[problem] = dict(zip(optimizers, ranked.tolist(), strict=True))
    of_functions = sorted({function for function, _ in ranks})
    return {
        "problems": len(ranks),
        "instances": len({instance for _, instance in ranks}),
        "optimizers": {
            name: {
                "mean rank": statistics.mean(each[name] for each in ranks.values()),
                "median rank": statistics.median(each[name] for each in ranks.values()),
                "first": sum(each[name] == min(each.values()) for each in ranks.values()),
                "seconds": statistics.median(found[name]["seconds"] for found in by_all.values()),
            }
            for name in optimizers
            if ranks
        },
        "functions": {
            f"f{function}": {
                name: statistics.mean(r[name] for (f, _), r in ranks.items() if f == function)
                for name in optimizers
            }
            for function in of_functions
        },
    }


def main() -> None:
    """Run the optimizers on the functions and report."""
    parser = result_parser(__doc__, "plain_problem.json")
    parser.add_argument("--kinds", nargs="+", choices=SUITES, default=list(SUITES))
    parser.add_argument("--functions", type=int, nargs="+", help="(default: all)")
    parser.add_argument("--dimensions", type=int, nargs="+", default=[2, 5, 10])
    parser.add_argument("--instances", type=int, nargs="*", default=[1, 2, 3], metavar="NUMBER")
    parser.add_argument("--evaluations", type=int, default=50, help="(default: %(default)s)")
    parser.add_argument("--optimizers", nargs="+", choices=[OWN, *PEERS], help="(default: all)")
    parser.add_argument("--also", type=Path, nargs="+", default=[], metavar="RECORD")
    arguments = parser.parse_args()
    if importlib.util.find_spec("cocoex") is None:
        raise SystemExit(f"error: the functions are those of {SUITE_PACKAGE}; pip install it")
    warnings.simplefilter("ignore")
    optimizers = [name for name in present() if name in (arguments.optimizers or (OWN, *PEERS))]
    packages = dict.fromkeys(package for package, _ in PEERS.values())
    now = provenance((*OTHER_PACKAGES, SUITE_PACKAGE, *packages))
    results = known([arguments.result, *arguments.also])

    def write() -> None:
        runs = [results[key] for key in sorted(results)]
        write_result(arguments.result, {"provenance": now, "runs": runs})

    for instance in arguments.instances:
        for kind in arguments.kinds:
            for dimension in arguments.dimensions:
                for function in arguments.functions or SUITES[kind][1]:
                    for name in optimizers:
                        key = (kind, dimension, arguments.evaluations, function, instance, name)
                        found = run(key) | {"commit": now["commit"]}
                        results[key] = dict(zip(COLUMNS, key, strict=True)) | found
                        print(*key, found["found"], found["seconds"], flush=True)
                    write()
    write()
    rows = [
        [group, name, *found.values()]
        for group, entry in summary(results.values()).items()
        for name, found in entry["optimizers"].items()
    ]
    print(table(["group", "optimizer", "mean rank", "median rank", "first", "time [s]"], rows))


if __name__ == "__main__":
    main()
