"""The truth of a parameter set of a problem in closed form: exact, without any sampling."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bo_tuner.numerics.arrays import Array
from tuning_benchmark.judging.truth import Judgement
from tuning_benchmark.problems import closed_form, two_basins

NODE = "problem"


class Judge:
    """Judges parameter sets of a closed-form problem.

    Its parameters are those of `truth.Judge`; the corners are not needed.
    """

    def __init__(
        self,
        constants: Mapping[str, Mapping[str, Any]],
        drawn: Mapping[str, Array],
        grid: Mapping[str, Array],
        corners: NDArray[np.intp],
        seed: int,
    ) -> None:
        self._problem = self.problem_of(constants[NODE])
        names = [f"w{j + 1}" for j in range(self._problem.contexts)]
        self._drawn = np.column_stack([drawn[name] for name in names])
        self._grid = np.column_stack([grid[name] for name in names])
        self._noise = np.random.default_rng(seed).standard_normal(len(self._drawn))

    @staticmethod
    def problem_of(
        settings: Mapping[str, Any],
    ) -> closed_form.ClosedForm | two_basins.TwoBasins:
        """Return the problem that a node's parameters describe."""
        return closed_form.problem_of(settings)

    def judge(self, values: Mapping[str, Mapping[str, Any]]) -> Judgement:
        """Compute the truth; the worst context is the nearest one of the grid."""
        problem, u = self._problem, self._problem.point(values[NODE])
        if problem.crashes(u):
            nothing = np.full(len(self._drawn), np.nan)
            return Judgement(np.nan, np.nan, np.nan, 0, nothing)
        worst, context = problem.worst(u)
        return Judgement(
            objective=float(problem.cost(u)) * problem.factor(values[NODE]),
            standard_error=0.0,
            worst=worst,
            worst_index=int(np.argmin(((self._grid - context) ** 2).sum(axis=1))),
            single=problem.observed(u, self._drawn, self._noise),
        )

    def worst_runs(self, values: Mapping[str, Mapping[str, Any]]) -> Array:
        """Constrained metric (1, m) of runs in the context where least keep the limit."""
        u = self._problem.point(values[NODE])
        if self._problem.crashes(u):
            return np.full((1, 1), np.nan)
        return self._problem.runs(u)[None]


class BasinsJudge(Judge):
    """Judges parameter sets of `TwoBasins`."""

    @staticmethod
    def problem_of(settings: Mapping[str, Any]) -> two_basins.TwoBasins:
        """Return the problem that a node's parameters describe."""
        return two_basins.problem_of(settings)
