"""Answers under limits on single runs: is the promise kept, and how far above the optimum are they.

    python benchmarks/single_run_limits.py                  all cases, 20 seeds each
    python benchmarks/single_run_limits.py two spikes --seeds 5

Each seed is another problem: a bowl of the cost, whose middle is beyond a limit on single runs, in
the cube of the parameters, with a load as context. The limit is over the loads, *drawn*, or in each
of them, *worst*. What share of runs a parameter set keeps within it is known, as the law of the
noise is, and so is the optimum. Beside `boundary` stands random sampling, the method II, with as
many runs.
"""

import math
import statistics
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import cached_property
from itertools import repeat
from typing import Any

import numpy as np
from common import provenance, read_result, result_parser, table, write_result
from scipy.optimize import differential_evolution
from threadpoolctl import threadpool_limits

import bo_tuner as bt
from bo_tuner.backends.function import FunctionBackend
from bo_tuner.methods.registry import DEFAULT_METHOD, METHODS
from bo_tuner.methods.repetitions import most_check_evaluations
from bo_tuner.numerics.arrays import Array
from bo_tuner.study.study import Study
from bo_tuner.tuning.driver import Driver
from bo_tuner.tuning.loop import Tuning
from bo_tuner.tuning.summary import choose_answer
from tuning_benchmark.problems.noise_laws import BIMODAL, LAWS, NORMAL, NoiseLaw

LOADS = (np.arange(64) + 0.5) / 64
"""Loads that stand for their distribution; the largest is that of the worst case."""

COST_NOISE, PEAK_NOISE = 0.05, 0.1
"""Standard deviations of the cost's logarithm, and of the limited metric where the load is 0."""

TRIALS = 40
RANDOM = "II"
"""The method with random sampling."""

SPIKES, DRAWN, WORST = "spikes", "drawn", "worst"

FURTHER: Mapping[str, NoiseLaw] = {
    # One run in ten, and no wider than the others.
    "rare": NoiseLaw.standardized((0.9, 0.0, 0.2), (0.1, 3.0, 0.2)),
    # As many of the one kind as of the other.
    "halves": NoiseLaw.standardized((0.5, 0.0, 0.4), (0.5, 2.5, 0.4)),
    # A tail that begins within the bulk.
    "skewed": NoiseLaw.standardized((0.7, 0.0, 0.5), (0.2, 1.0, 0.7), (0.1, 2.5, 1.0)),
    # Long tails on both sides, as after a division.
    "tails": NoiseLaw.standardized((0.85, 0.0, 0.5), (0.15, 0.0, 2.2)),
}


@dataclass(frozen=True)
class Problem:
    """A problem, drawn by its seed.

    Attributes
    ----------
    seed
        Of the problem, and of the run that tunes it.
    probability
        P, with which a run must keep the limit.
    law
        Of the noise.
    parameters
        d, their number.
    everywhere
        Whether the limit must be kept under each load, or over their distribution.
    """

    seed: int
    probability: float
    law: NoiseLaw
    parameters: int = 2
    everywhere: bool = False

    @cached_property
    def _constants(self) -> tuple[Array, Array, Array]:
        """Curvatures (d,) and middle (d,) of the bowl, and the direction (d,) of the limit."""
        rng = np.random.default_rng(self.seed)
        curvatures = rng.uniform(1.0, 4.0, self.parameters)
        middle = rng.uniform(0.55, 0.9, self.parameters)
        direction = rng.uniform(0.3, 1.0, self.parameters)
        return curvatures, middle, direction / np.sqrt(direction @ direction)

    def cost(self, u: Array) -> float:
        """Return the mean of the cost at u (d,)."""
        curvatures, middle, _ = self._constants
        return float(0.5 + curvatures @ (u - middle) ** 2)

    def response(self, u: Array, load: Array) -> tuple[Array, Array]:
        """Return mean and standard deviation of the limited metric at u (d,) under each load."""
        _, middle, direction = self._constants
        along = direction @ u / (direction @ middle)
        mean = (0.3 + 0.7 * along**2) * (0.9 + 0.3 * load)
        return mean, PEAK_NOISE * (1.0 + load)

    def kept(self, u: Array) -> float:
        """Return the share of runs within the limit: over the loads, or under the worst one."""
        mean, deviation = self.response(u, np.append(LOADS, 1.0) if self.everywhere else LOADS)
        shares = self.law.kept((1.0 - mean) / deviation)
        return float(shares.min() if self.everywhere else shares.mean())

    @cached_property
    def optimum(self) -> float:
        """Least cost of what keeps the promise."""

        def penalized(u: Array) -> float:
            return self.cost(u) + 100.0 * max(self.probability - self.kept(u), 0.0)

        bounds = [(0.0, 1.0)] * self.parameters
        return float(differential_evolution(penalized, bounds, rng=1, tol=1e-8).fun)

    def truth(self, parameters: Mapping[str, Any]) -> dict[str, Any]:
        """Return what a parameter set keeps, and by what share its cost is above the optimum."""
        u = point(parameters)
        kept = self.kept(u)
        above = self.cost(u) / self.optimum - 1.0
        return {"kept": kept, "keeps": kept >= self.probability, "above": above}

    def run(
        self, parameters: Mapping[str, Any], context: Mapping[str, Any], seed: int
    ) -> dict[str, float]:
        """Return the metrics of one run, as a function that is tuned does."""
        z_cost, z_peak = np.random.default_rng(seed).standard_normal(2)
        u = point(parameters)
        mean, deviation = self.response(u, np.array(context["load"]))
        return {
            "cost": self.cost(u) * float(np.exp(COST_NOISE * z_cost - 0.5 * COST_NOISE**2)),
            "peak": float(mean + deviation * self.law.of_normal(z_peak)),
        }

    def study(self, trials: int, evaluations: int | None = None) -> Study:
        """Return the study."""
        kind = bt.WorstCase if self.everywhere else bt.Chance
        return bt.Study(
            name="single_run_limits",
            parameters={f"x{k}": bt.Double(0.0, 1.0, default=0.1) for k in range(self.parameters)},
            contexts={"load": bt.Uniform(bounds=(0.0, 1.0))},
            metrics=["cost", "peak"],
            objective="cost",
            constraints={"peak": kind("peak", upper=1.0, probability=self.probability)},
            budget=bt.Budget(
                trials=trials, initial_trials=5 * self.parameters, evaluations=evaluations
            ),
            seed=self.seed,
        ).checked


def point(parameters: Mapping[str, Any]) -> Array:
    """Return a parameter set as a point (d,)."""
    return np.array([float(value) for value in parameters.values()])


@dataclass(frozen=True)
class Case:
    """Problems that differ by their seed."""

    title: str
    probability: float
    law: str = NORMAL
    parameters: int = 2
    everywhere: bool = False

    def problem(self, seed: int) -> Problem:
        """Return the problem of a seed."""
        law = {**LAWS, **FURTHER}[self.law]
        return Problem(seed, self.probability, law, self.parameters, self.everywhere)


CASES: Mapping[str, Case] = {
    "two": Case("2 parameters, P 0.9", 0.9),
    "strict": Case("2 parameters, P 0.95", 0.95),
    "four": Case("4 parameters, P 0.9", 0.9, parameters=4),
    "spikes": Case("P 0.97, one run in twenty far off", 0.97, SPIKES),
    **{
        f"{law}_{where}": Case(f"P 0.95, {title}, {where}", 0.95, law, everywhere=where == WORST)
        for law, title in (
            (BIMODAL, "one run in five far off"),
            ("rare", "one run in ten far off"),
            ("halves", "two kinds of runs, as many of each"),
            ("skewed", "a long tail"),
            ("tails", "long tails on both sides"),
        )
        for where in (DRAWN, WORST)
    },
}


def tuned(problem: Problem, study: Study, method: str) -> dict[str, Any]:
    """Tune a study of a problem, and judge the answer by the truth."""
    runs = 0

    def run(*arguments: Any) -> dict[str, float]:
        nonlocal runs
        runs += 1
        return problem.run(*arguments)

    rule = METHODS[method]
    driver = Driver(FunctionBackend(study, run))
    tried = list(Tuning(study, driver, rule))
    answer = choose_answer(study, driver, rule, tried)
    truths = [problem.truth(trial.parameters) for trial in tried]
    found: dict[str, Any] = {
        "runs": runs,
        "best_tried": min((t["above"] for t in truths if t["keeps"]), default=None),
    }
    if answer is None:
        return found
    return found | problem.truth(answer.candidate.trial.parameters) | {"shown": answer.feasible}


def both(name: str, seed: int) -> dict[str, Any]:
    """Tune the problem of a seed, and beside it by random sampling with as many runs."""
    problem = CASES[name].problem(seed)
    with threadpool_limits(1):
        study = problem.study(TRIALS)
        found = tuned(problem, study, DEFAULT_METHOD)
        other = problem.study(TRIALS, found["runs"] - most_check_evaluations(study))
        return {"seed": seed, **found, "random": tuned(problem, other, RANDOM)}


def row(name: str, found: Sequence[Mapping[str, Any]]) -> list[object]:
    """Sum up a case: how many kept the promise, and how far they are above the optimum."""
    cells: list[object] = [CASES[name].title]
    for of in (found, [run["random"] for run in found]):
        answers = [run for run in of if "kept" in run]
        cells += [
            f"{sum(run['keeps'] for run in answers)} of {len(of)}",
            f"{min((run['kept'] for run in answers), default=math.nan):.3f}",
            f"{100.0 * statistics.median(run['above'] for run in answers):.0f}",
            statistics.median(run["runs"] for run in of),
        ]
    return cells


HEADER = ("", "kept", "least", "above [%]", "runs", "random: kept", "least", "above [%]", "runs")


def main() -> None:
    """Tune and report."""
    parser = result_parser(__doc__, "single_run_limits.json")
    parser.add_argument("cases", nargs="*", help=f"of {', '.join(CASES)}; all unless given")
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--workers", type=int, default=2)
    arguments = parser.parse_args()
    known = read_result(arguments.result) or {}
    result: dict[str, Any] = {"provenance": provenance(), "cases": known.get("cases", {})}
    with ProcessPoolExecutor(arguments.workers) as pool:
        for name in arguments.cases or CASES:
            runs = list(pool.map(both, repeat(name), range(1, arguments.seeds + 1)))
            print(table(HEADER, [row(name, runs)]), flush=True)
            result["cases"][name] = {"title": CASES[name].title, "runs": runs}
            # Each case takes minutes, and those of another call stay.
            write_result(arguments.result, result)


if __name__ == "__main__":
    main()
