"""How often a parameter that does nothing is said to move a metric, and one that does is not seen.

On closed forms, in many runs each: the trials of `tune`, where the points come nearer to the best
one in all parameters, those that do nothing included; and the runs of `check`, one parameter
at a time and in a screening design. Three of four parameters, or the last of ten, do nothing. What
would have been seen is then given to the last one as its effect, in runs of their own.
"""

import json
from collections.abc import Callable, Sequence

import numpy as np
from common import provenance, result_parser
from threadpoolctl import threadpool_limits

from bo_tuner.models.categories import Coding
from bo_tuner.models.dependence import dependences
from bo_tuner.numerics.arrays import Array
from bo_tuner.numerics.hadamard import screening_design
from bo_tuner.numerics.latin_hypercube import latin_hypercube
from bo_tuner.numerics.linear_effects import POWER, linear_effect
from bo_tuner.tuning.effects import ERROR

SEEDS = 200
DIMENSION, FIRST = 4, 8
METRICS = 3
"""Tests of each parameter, among which the error is divided."""
SHARE_OF_RANDOM, WIDTH = 0.15, 0.15
"""How an optimizer proposes: at random, or as near as this to the best point."""

Function = Callable[[Array], float]
PROBLEMS: dict[str, Function] = {
    "bowl": lambda x: float(4.0 * (x[0] - 0.3) ** 2 + 2.0 * (x[1] - 0.6) ** 2 + x[0] * x[1]),
    "valley": lambda x: float(
        np.log1p((3.0 - 4.0 * x[0]) ** 2 + 10.0 * (4.0 * x[1] - 1.0 - (4.0 * x[0] - 2.0) ** 2) ** 2)
    ),
    "steep": lambda x: float(np.exp(6.0 * x[0])),
    "nothing": lambda _: 0.0,
}
"""Of the four coordinates the last two do nothing."""


def main() -> None:
    """Count, and write the result."""
    parser = result_parser(__doc__, "parameter_effects.json")
    parser.add_argument("--seeds", type=int, default=SEEDS)
    arguments = parser.parse_args()
    result = {"provenance": provenance(), "seeds": arguments.seeds, "error": ERROR, "power": POWER}
    with threadpool_limits(1):
        result["trials"] = [
            trials(name, count, noise, arguments.seeds)
            for name in PROBLEMS
            for count in (15, 30)
            for noise in (0.02, 0.3)
        ]
        result["check"] = [singly(arguments.seeds), screened(arguments.seeds)]
    arguments.result.write_text(json.dumps(result, indent=2) + "\n", encoding="utf-8")


def trials(name: str, count: int, noise: float, seeds: int) -> dict[str, object]:
    """Judge the parameters by trials around the best one."""
    function, level = PROBLEMS[name], ERROR / (DIMENSION * METRICS)
    alarms = {"single test": 0, "run": 0}
    live, seen = np.zeros(2), 0
    for seed in range(seeds):
        rng = np.random.default_rng([seed, count])
        points = _chosen(function, count, noise, rng)
        values = _observed(function, points, noise, rng)
        found = dependences(points, values, Coding((0,) * DIMENSION), DIMENSION, level, rng)
        # A single test at 5 % tells more of the test in as many runs.
        alarms["single test"] += sum(effect.p_value < ERROR for effect in found[2:])
        alarms["run"] += any(effect.p_value < level for effect in found[2:])
        live += [effect.p_value < level for effect in found[:2]]
        effect = found[3].visible
        if np.isfinite(effect):
            again = _observed(function, points, noise, rng) + effect * points[:, 3]
            last = dependences(points, again, Coding((0,) * DIMENSION), DIMENSION, level, rng)[3]
            seen += last.p_value < level
        else:
            seen += 1
    return {
        "problem": name,
        "trials": count,
        "noise": noise,
        "false alarms of a test at 5 %": alarms["single test"] / (2 * seeds),
        "false alarms of a run": alarms["run"] / seeds,
        "live ones seen": (live / seeds).tolist(),
        "smallest effect seen": seen / seeds,
    }


def singly(seeds: int) -> dict[str, object]:
    """Three parameters at a time, each at two values, beside eight runs of the default."""
    counts = [8, 2, 2]
    factor = np.repeat(np.eye(3), counts, axis=0)[:, 1:]
    return _check("one at a time", factor, np.ones((12, 1)), np.eye(2), 3, seeds)


def screened(seeds: int) -> dict[str, object]:
    """Ten parameters at once."""
    design = screening_design(10, np.random.default_rng(0))
    others = np.column_stack([np.ones(len(design)), design[:, 1:]])
    return _check("screening design", design[:, :1], others, np.array([[2.0]]), 10, seeds)


def _check(
    what: str, factor: Array, others: Array, contrasts: Array, parameters: int, seeds: int
) -> dict[str, object]:
    """Test a factor without an effect, and one of the smallest size; ten times as many runs."""
    level, runs, rng = ERROR / (parameters * METRICS), 10 * seeds, np.random.default_rng(1)
    alarms, sizes = 0, []
    for _ in range(runs):
        found = linear_effect(rng.normal(size=len(factor)), others, factor, contrasts, level)
        alarms += found.p_value < level
        sizes.append(found.visible**2)
    size = np.sqrt(np.mean(sizes))
    # The least visible shape of that size, see `numerics.linear_effects`.
    own = factor - others @ np.linalg.lstsq(others, factor, rcond=None)[0]
    inverse = np.linalg.inv(own.T @ own)
    spread = np.diag(contrasts @ inverse @ contrasts.T)
    shape = inverse @ contrasts[int(np.argmax(spread))] / spread.max()
    seen = 0
    for _ in range(runs):
        response = factor @ (size * shape) + rng.normal(size=len(factor))
        seen += linear_effect(response, others, factor, contrasts, level).p_value < level
    return {
        "design": what,
        "runs": len(factor),
        "false alarms of a test": alarms / runs,
        "level": level,
        "smallest effect in noise": float(size),
        "smallest effect seen": seen / runs,
    }


def _chosen(function: Function, count: int, noise: float, rng: np.random.Generator) -> Array:
    """Choose points (n, d) as an optimizer does, which minimizes the function."""
    points: Sequence[Array] = list(latin_hypercube(FIRST, DIMENSION, rng))
    values = [function(x) + noise * rng.normal() for x in points]
    while len(points) < count:
        near = points[int(np.argmin(values))] + WIDTH * rng.normal(size=DIMENSION)
        anywhere = rng.random() < SHARE_OF_RANDOM
        points = [*points, rng.random(DIMENSION) if anywhere else np.clip(near, 0.0, 1.0)]
        values.append(function(points[-1]) + noise * rng.normal())
    return np.array(points)


def _observed(function: Function, points: Array, noise: float, rng: np.random.Generator) -> Array:
    return np.array([function(x) for x in points]) + noise * rng.normal(size=len(points))


if __name__ == "__main__":
    main()
