"""The truth of a parameter set of the controller, by many more cuts than a tuner has.

E is the mean tracking error over many contexts drawn from their distribution. The worst overshoot
is the largest, over a grid of contexts up to their bounds, of the mean over noise draws; since the
noise of few draws moves it, the worst contexts can also be judged by more. The contexts and the
noise are the same for all parameter sets, so that their differences are more accurate than each.

The loop is the vectorized one, which solves its programs exactly. Whether a controller is fast
enough, or its solver gives up, only shows in cuts on the objects.
"""

from collections.abc import Mapping
from dataclasses import asdict
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from feed_axis_common.errors import FeedAxisError
from feed_axis_common.model import Array
from feed_axis_common.parameters import build
from milling_plant.cut import reference_velocity
from milling_plant.settings import PlantSettings
from milling_plant.settings import default_settings as plant_defaults
from mpc_controller.settings import ControllerSettings
from mpc_controller.settings import default_settings as controller_defaults
from tuning_benchmark.judging.truth import Judgement
from tuning_benchmark.milling.closed_loop_batch import CutBatch

PLANT, CONTROLLER = "plant", "controller"

NOISE = 20
"""Noise draws in each context of the grid."""

CANDIDATES, MORE_NOISE = 3, 400
"""Number of the worst contexts of the grid that are judged again, and of draws in each."""

ROUGH = 10
"""One in this many drawn contexts serves a rough judgement."""


class Judge:
    """Judges parameter sets of the controller, all in the same contexts and noise.

    Its parameters are those of `truth.Judge`, the nodes ``plant`` and ``controller``.
    """

    def __init__(
        self,
        constants: Mapping[str, Mapping[str, Any]],
        drawn: Mapping[str, Array],
        grid: Mapping[str, Array],
        corners: NDArray[np.intp],
        seed: int,
    ) -> None:
        self._plant = build(PlantSettings, asdict(plant_defaults()) | dict(constants[PLANT]))
        self._constants = asdict(controller_defaults()) | dict(constants[CONTROLLER])
        self._drawn, self._grid, self._corners = dict(drawn), dict(grid), corners
        samples = reference_velocity(self._plant).size
        deviation = self._plant.noise_variance**0.5
        rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(1,)))
        self._drawn_noise = rng.normal(0.0, deviation, (_count(drawn), samples))
        self._grid_noise = rng.normal(0.0, deviation, (_count(grid), NOISE, samples))
        self._more_noise = rng.normal(0.0, deviation, (MORE_NOISE, samples))
        self._precise_batches: dict[int, CutBatch] = {}

    def judge(self, values: Mapping[str, Mapping[str, Any]]) -> Judgement:
        """Find the truth of the controller's parameters in `values`, by node."""
        try:
            C, single = self.drawn(values)
            means = self.grid_overshoot(values)
        except FeedAxisError:
            nothing = np.full(len(self._drawn_noise), np.nan)
            return Judgement(np.nan, np.nan, np.nan, 0, nothing)
        worst = int(np.argmax(np.where(np.isnan(means), np.inf, means)))
        return Judgement(
            objective=float(C.mean()),
            standard_error=float(C.std(ddof=1) / np.sqrt(len(C))),
            worst=float(means[worst]),
            worst_index=worst,
            single=single,
        )

    def drawn(self, values: Mapping[str, Mapping[str, Any]]) -> tuple[Array, Array]:
        """Tracking errors and overshoots in the drawn contexts, each (drawn,).

        Raises
        ------
        ControllerError
            If the controller's program is singular; so do the methods below.
        """
        result = self._drawn_batch.run(self._settings(values))
        return result.tracking_error, result.overshoot

    def grid_overshoot(self, values: Mapping[str, Mapping[str, Any]]) -> Array:
        """Mean overshoot [m/s] over noise in each context of the grid, shape (grid,)."""
        overshoot = self._grid_batch.run(self._settings(values)).overshoot
        means: Array = overshoot.reshape(-1, NOISE).mean(axis=1)
        return means

    def corner_overshoot(self, values: Mapping[str, Mapping[str, Any]]) -> float:
        """Largest mean overshoot [m/s] of the grid's corners only: most infeasible points show."""
        overshoot = self._corner_batch.run(self._settings(values)).overshoot
        return float(overshoot.reshape(-1, NOISE).mean(axis=1).max())

    def rough(self, values: Mapping[str, Mapping[str, Any]]) -> tuple[float, float]:
        """Mean tracking error of some drawn contexts and `corner_overshoot`, cheaper together."""
        result = self._rough_batch.run(self._settings(values))
        corners = len(self._corners) * NOISE
        means = result.overshoot[:corners].reshape(-1, NOISE).mean(axis=1)
        return float(result.tracking_error[corners:].mean()), float(means.max())

    def precise_worst(self, values: Mapping[str, Mapping[str, Any]]) -> float:
        """Worst overshoot [m/s], of only the few worst contexts, by more draws than a judgement."""
        means = self.grid_overshoot(values)
        order = np.argsort(-np.where(np.isnan(means), np.inf, means), kind="stable")
        settings = self._settings(values)
        return max(
            float(self._precise_runs(settings, int(index)).mean()) for index in order[:CANDIDATES]
        )

    def worst_runs(self, values: Mapping[str, Mapping[str, Any]]) -> Array:
        """Overshoots [m/s] (`CANDIDATES`, `MORE_NOISE`) of single cuts in the worst contexts.

        The contexts are those of the grid with the largest mean and standard deviation together.
        """
        settings = self._settings(values)
        runs = self._grid_batch.run(settings).overshoot.reshape(-1, NOISE)
        reached = runs.mean(axis=1) + runs.std(axis=1, ddof=1)
        order = np.argsort(-np.where(np.isnan(reached), np.inf, reached), kind="stable")
        return np.array([self._precise_runs(settings, int(index)) for index in order[:CANDIDATES]])

    def _settings(self, values: Mapping[str, Mapping[str, Any]]) -> ControllerSettings:
        return build(ControllerSettings, self._constants | dict(values[CONTROLLER]))

    def _precise_runs(self, settings: ControllerSettings, index: int) -> Array:
        if index not in self._precise_batches:
            rows = {k: np.full(MORE_NOISE, column[index]) for k, column in self._grid.items()}
            self._precise_batches[index] = CutBatch(self._plant, rows, self._more_noise)
        return self._precise_batches[index].run(settings).overshoot

    @cached_property
    def _drawn_batch(self) -> CutBatch:
        return CutBatch(self._plant, self._drawn, self._drawn_noise)

    @cached_property
    def _grid_batch(self) -> CutBatch:
        return self._repeated(np.arange(len(self._grid_noise)))

    @cached_property
    def _corner_batch(self) -> CutBatch:
        return self._repeated(self._corners)

    @cached_property
    def _rough_batch(self) -> CutBatch:
        corners = self._rows(self._corners)
        contexts = {k: np.append(corners[k], self._drawn[k][::ROUGH]) for k in self._drawn}
        noise = self._grid_noise[self._corners].reshape(-1, self._grid_noise.shape[2])
        return CutBatch(self._plant, contexts, np.vstack([noise, self._drawn_noise[::ROUGH]]))

    def _repeated(self, rows: NDArray[np.intp]) -> CutBatch:
        noise = self._grid_noise[rows].reshape(-1, self._grid_noise.shape[2])
        return CutBatch(self._plant, self._rows(rows), noise)

    def _rows(self, rows: NDArray[np.intp]) -> dict[str, Array]:
        return {k: np.repeat(column[rows], NOISE) for k, column in self._grid.items()}


def _count(contexts: Mapping[str, Array]) -> int:
    return len(next(iter(contexts.values())))
