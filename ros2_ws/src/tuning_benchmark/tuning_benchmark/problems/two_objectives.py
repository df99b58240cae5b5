"""A problem with two objectives under a robust limit, whose Pareto front is known exactly.

Notation: u in [0, 1]^d are the parameters, x = u + sin(2πu) / (4π) the same warped, coordinate by
coordinate and increasing (that of `closed_form`); w in [-1, 1]^m are the contexts, with E[w] = 0; n
is standard normal.

Costs
    f_1 = |x - p|² and f_2 = |x - q|², each times (1 + κ w_j) exp(σ n - σ²/2) with j its number, so
    that these are the means over contexts and noise.
Constrained metric
    g = s (1 + β mean(w)) + σ_g n with s = (x - p)·(q - p) / |q - p|², the share of the way from p
    to q. For s > 0 its mean is worst at w = 1, where it keeps the limit up to
    s = LIMIT / (1 + β).
Front
    Of all points with the same s, both costs are least on the line from p to q. There
    f_1 = (D s)² and f_2 = (D (1 - s))² with D = |q - p|; the front under the limit is its part with
    0 ≤ s ≤ LIMIT / (1 + β).
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from bo_tuner.numerics.arrays import Array
from bo_tuner.study.study import Study
from tuning_benchmark.problems.node import NODE, ParameterizedNode, problem_study
from tuning_benchmark.problems.warp import warped

LIMIT = 0.8
LEAN = 0.25
"""β."""
KAPPA = 0.3
NOISE, METRIC_NOISE = 0.1, 0.02
"""σ and σ_g."""
DISTANCE = 0.6
"""D."""
BEYOND = 1.1
"""The reference point of hypervolumes relative to the worst costs on the front."""
POINTS = 2000
"""On the front, for its hypervolume."""


@dataclass(frozen=True)
class TwoObjectives:
    """The problem with d parameters; the direction from p to q is drawn from a fixed seed.

    Attributes
    ----------
    parameters
        d ≥ 2.
    contexts
        m ≥ 2.
    """

    parameters: int
    contexts: int = 2

    @cached_property
    def ends(self) -> tuple[Array, Array]:
        """Warped points p and q (d,), where one of the costs is zero."""
        rng = np.random.default_rng([self.parameters, self.contexts])
        direction = rng.normal(size=self.parameters)
        half = 0.5 * DISTANCE * direction / np.linalg.norm(direction)
        return 0.5 - half, 0.5 + half

    def costs(self, u: Array) -> Array:
        """Return the expected costs (..., 2) of points (..., d) of the cube."""
        x = warped(u)
        return np.stack([((x - end) ** 2).sum(axis=-1) for end in self.ends], axis=-1)

    def share(self, u: Array) -> Array:
        """Return s (...) of points (..., d) of the cube."""
        p, q = self.ends
        result: Array = (warped(u) - p) @ (q - p) / DISTANCE**2
        return result

    def worst(self, u: Array) -> Array:
        """Return the worst mean of the constrained metric (...) of points (..., d)."""
        share = self.share(u)
        result: Array = share * np.where(share > 0.0, 1.0 + LEAN, 1.0 - LEAN)
        return result

    @cached_property
    def front(self) -> Array:
        """Costs (n, 2) of points on the true front under the limit."""
        share = np.linspace(0.0, LIMIT / (1.0 + LEAN), POINTS)
        return np.column_stack([(DISTANCE * share) ** 2, (DISTANCE * (1.0 - share)) ** 2])

    def volume(self, points: Array) -> float:
        """Return the hypervolume of points (n, d) relative to that of the true front.

        Points that violate the limit count nothing.
        """
        reference = BEYOND * self.front.max(axis=0)
        kept = points[self.worst(points) <= LIMIT]
        return hypervolume(self.costs(kept), reference) / hypervolume(self.front, reference)

    def study(self) -> Study:
        """Return the study, which runs in process."""
        parameter = NODE | {"type": "double", "bounds": [0.0, 1.0], "default": 0.5}
        context = NODE | {"distribution": "uniform", "bounds": [-1.0, 1.0]}
        settings = {"parameters": self.parameters, "contexts": self.contexts}
        return problem_study(
            f"{__name__}:Node",
            settings,
            name=f"two_objectives_{self.parameters}",
            parameters={f"p{i + 1}": parameter for i in range(self.parameters)},
            contexts={f"w{j + 1}": context for j in range(self.contexts)},
            metrics={"first": NODE, "second": NODE, "share": NODE},
            objective={"metric": "first"},
            further_objectives=[{"metric": "second"}],
            constraints={"share": {"kind": "worst_case", "metric": "share", "upper": LIMIT}},
        )

    def point(self, values: Mapping[str, Any]) -> Array:
        """Unit-cube coordinates (d,) of the parameters ``p1`` to ``pd``."""
        return np.array([values[f"p{i + 1}"] for i in range(self.parameters)])


def hypervolume(costs: Array, reference: Array) -> float:
    """Return the area that points of costs (n, 2) dominate, up to a reference point (2,).

    Points beyond the reference in a cost add nothing.
    """
    inside = costs[(costs < reference).all(axis=1)]
    first, second = inside[np.argsort(inside[:, 1], kind="stable")].T
    heights = np.diff(second, append=reference[1])
    return float(sum(heights * (reference[0] - np.minimum.accumulate(first))))


class Node(ParameterizedNode):
    """A node that evaluates the problem."""

    def evaluate(self) -> dict[str, object]:
        """Evaluate the point in the context."""
        values = self.values
        problem = TwoObjectives(values["parameters"], values["contexts"])
        u = problem.point(values)
        w = np.array([values[f"w{j + 1}"] for j in range(problem.contexts)])
        noise = np.random.default_rng(values["seed"]).standard_normal(3)
        factors = (1.0 + KAPPA * w[:2]) * np.exp(NOISE * noise[:2] - 0.5 * NOISE**2)
        first, second = problem.costs(u) * factors
        share = float(problem.share(u)) * (1.0 + LEAN * w.mean()) + METRIC_NOISE * noise[2]
        return {
            "status": "ok",
            "first": float(first),
            "second": float(second),
            "share": float(share),
        }
