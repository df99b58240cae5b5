"""A narrow optimum beside a wide basin, with a limit that does not bind.

Notation: u in [0, 1]^d are the parameters, x the same, warped by `closed_form`; w in [-1, 1]^m are
the contexts, with E[w] = 0; n, n' are standard normal; |v|² = Σ_i v_i² / d.

Cost
    C = B(x) (1 + κ w_1) exp(σ_C n - σ_C² / 2), with the least of two bowls
    B(x) = min(1 + c |x - p|², 1 - D (1 - |x - q|² / r²)). So E[C] = B(x). The wide bowl is nowhere
    below 1, and the narrow one is below 1 where |x - q| < r only: the optimum is q, with 1 - D. A
    search that stays in the wide basin ends at p, with 1.
Limited metric
    g = ½ + λ mean(x) + ℓ w_1 + σ n', whose worst case ½ + λ mean(x) + ℓ is below the limit 1
    everywhere, by many σ.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from scipy.special import ndtr, ndtri

from bo_tuner.codec import checks
from bo_tuner.codec.rules import POSITIVE
from bo_tuner.numerics.arrays import Array
from bo_tuner.study.study import Study
from tuning_benchmark.problems.node import NODE, ParameterizedNode, problem_study
from tuning_benchmark.problems.warp import unwarped, warped

LIMIT = 1.0
CURVATURE = 1.0
"""c."""
DEPTH = 0.4
"""D."""
KAPPA, COST_NOISE = 0.1, 0.05
"""κ and σ_C."""
OFFSET, SLOPE, LEAN, NOISE = 0.5, 0.1, 0.05, 0.02
"""½, λ, ℓ and σ."""
APART = 0.4
"""Least distance |p - q| of both bottoms."""
QUANTILES = 2000
"""Runs that stand for the noise in the worst context."""


@dataclass(frozen=True, kw_only=True)
class TwoBasins:
    """The problem; p and q are drawn from a generator seeded by the number of parameters.

    Attributes
    ----------
    parameters
        d ≥ 2.
    radius
        r, the half width of the narrow basin in edges of the cube.
    contexts
        m ≥ 1.

    Raises
    ------
    StudyError
        If a value is out of range.
    """

    parameters: int
    radius: float = 0.15
    contexts: int = 1

    def __post_init__(self) -> None:
        checks.integer(self.parameters, "parameters", at_least=2)
        checks.integer(self.contexts, "contexts", at_least=1)
        POSITIVE(self.radius, "radius")

    @cached_property
    def bottoms(self) -> tuple[Array, Array]:
        """Warped bottoms p and q (d,) of the wide and of the narrow basin."""
        rng = np.random.default_rng((20_201_116, self.parameters))
        while True:
            p, q = warped(rng.uniform(0.1, 0.9, (2, self.parameters)))
            # The default is the cube's centre, which is in neither.
            if _squared(p - q) > APART**2 and _squared(q - 0.5) > (1.5 * self.radius) ** 2:
                return p, q

    @cached_property
    def optimum(self) -> Array:
        """Unit-cube coordinates (d,) of the optimum."""
        return unwarped(self.bottoms[1])

    @property
    def best(self) -> float:
        """Expected cost at the optimum."""
        return 1.0 - DEPTH

    def cost(self, u: Array) -> Array:
        """Return the expected cost B of points (..., d) of the cube, shape (...)."""
        x, (p, q) = warped(u), self.bottoms
        wide = 1.0 + CURVATURE * _squared(x - p)
        return np.minimum(wide, 1.0 - DEPTH * (1.0 - _squared(x - q) / self.radius**2))

    def factor(self, values: Mapping[str, Any]) -> float:
        """Return the factor of the cost by a choice, of which there is none."""
        return 1.0

    def metric(self, u: Array, w: Array) -> Array:
        """Mean over noise of the limited metric of points (..., d) in contexts (..., m)."""
        result: Array = OFFSET + SLOPE * warped(u).mean(axis=-1) + LEAN * w[..., 0]
        return result

    def observed(self, u: Array, w: Array, z: Array) -> Array:
        """Return the limited metric of runs with standard normal draws z (...)."""
        return self.metric(u, w) + NOISE * z

    def worst(self, u: Array) -> tuple[float, Array]:
        """Largest mean over noise of the limited metric at a point (d,), and its context."""
        context = np.zeros(self.contexts)
        context[0] = 1.0
        return float(self.metric(u, context)), context

    def kept(self, u: Array) -> float:
        """Least probability over all contexts that a run at a point (d,) keeps the limit."""
        return float(ndtr((LIMIT - self.worst(u)[0]) / NOISE))

    def crashes(self, u: Array) -> bool:
        """Whether an evaluation fails: none does."""
        return False

    def runs(self, u: Array) -> Array:
        """Quantiles (`QUANTILES`,) of runs in the worst context, at equal steps of probability."""
        levels = (np.arange(QUANTILES) + 0.5) / QUANTILES
        return self.observed(u, self.worst(u)[1], ndtri(levels))

    def study(self) -> Study:
        """Return the study, which runs in process."""
        parameter = NODE | {"type": "double", "bounds": [0.0, 1.0], "default": 0.5}
        context = NODE | {"distribution": "uniform", "bounds": [-1.0, 1.0]}
        settings = {
            "parameters": self.parameters,
            "contexts": self.contexts,
            "radius": self.radius,
        }
        return problem_study(
            f"{__name__}:Node",
            settings,
            name=f"two_basins_{self.parameters}",
            parameters={f"p{i + 1}": parameter for i in range(self.parameters)},
            contexts={f"w{j + 1}": context for j in range(self.contexts)},
            metrics={"cost": NODE, "stress": NODE},
            objective={"metric": "cost"},
            constraints={"stress": {"kind": "worst_case", "metric": "stress", "upper": LIMIT}},
        )

    def point(self, values: Mapping[str, Any]) -> Array:
        """Unit-cube coordinates (d,) of the parameters ``p1`` to ``pd``."""
        return np.array([values[f"p{i + 1}"] for i in range(self.parameters)])


class Node(ParameterizedNode):
    """A node that evaluates the problem; its parameters are the problem's, and the point."""

    def evaluate(self) -> dict[str, object]:
        """Evaluate cost and stress once."""
        values = self.values
        problem = problem_of(values)
        u = problem.point(values)
        w = np.array([values[f"w{j + 1}"] for j in range(problem.contexts)])
        noise = np.random.default_rng(int(values["seed"])).standard_normal(2)
        factor = (1.0 + KAPPA * w[0]) * np.exp(COST_NOISE * noise[0] - 0.5 * COST_NOISE**2)
        cost, stress = problem.cost(u) * factor, problem.observed(u, w, noise[1])
        return {"status": "ok", "reason": "", "cost": float(cost), "stress": float(stress)}


def problem_of(settings: Mapping[str, Any]) -> TwoBasins:
    """Return the problem that parameters of the node describe."""
    return TwoBasins(
        parameters=int(settings["parameters"]),
        contexts=int(settings["contexts"]),
        radius=float(settings["radius"]),
    )


def _squared(v: Array) -> Array:
    """Return |v|² of vectors (..., d), shape (...)."""
    result: Array = (v**2).mean(axis=-1)
    return result
