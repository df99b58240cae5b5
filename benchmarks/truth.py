"""The truth of a parametrization, by far more cuts than a tuner has.

E is the mean tracking error over many contexts drawn from the study's distribution. The worst
overshoot is the largest, over a regular grid of contexts up to their bounds, of the mean over
noise draws; since the noise of few draws moves it, the worst contexts are also judged by more. All
parametrizations meet the same contexts and noise, so that differences between them are known better
than each. The real-time constraint needs the controller's own solver, hence cuts on the objects.

Serves studies of the feed axis whose only worst case is the overshoot.
"""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from functools import cached_property

import numpy as np
from closed_loop_batch import Array, CutBatch

from bo_tuner.backends.inprocess import InProcessBackend
from bo_tuner.study import Study
from bo_tuner.trials import CutState, Value
from bo_tuner.tuning import run_cut
from milling_plant.cut import reference_velocity
from milling_plant.settings import PlantSettings
from milling_plant.settings import default_settings as plant_defaults
from mpc_controller.parameters import build
from mpc_controller.settings import ControllerSettings
from mpc_controller.settings import default_settings as controller_defaults

PLANT, CONTROLLER = "plant", "controller"
SEED = 20_201_115
"""Of all draws here; far from the seeds of the runs that are judged."""


@dataclass(frozen=True)
class Effort:
    """How much the truth costs.

    Attributes
    ----------
    drawn
        Contexts drawn for E.
    grid, noise
        Values of each context variable, and noise draws in each context of the grid.
    candidates, more_noise
        So many contexts, the worst of the grid, are judged again by so many draws.
    real_cuts
        Cuts on the objects for the chance constraints.
    """

    drawn: int = 600
    grid: int = 7
    noise: int = 20
    candidates: int = 3
    more_noise: int = 400
    real_cuts: int = 50


@dataclass(frozen=True)
class Judgement:
    """The truth of one parametrization.

    Attributes
    ----------
    E
        Expected tracking error [(m/s)^2]; NaN if the loop diverged in some context.
    standard_error
        Of E, over the draws [(m/s)^2].
    worst
        Worst overshoot [m/s]: the largest mean over noise of all contexts of the grid.
    worst_context
        Where.
    worst_precise
        The same by more draws [m/s], of the few worst contexts.
    single_violation
        Share of single cuts in drawn contexts that exceed the limit.
    """

    E: float
    standard_error: float
    worst: float
    worst_context: dict[str, float]
    worst_precise: float
    single_violation: float


class Truth:
    """Judges parametrizations of a study.

    Parameters
    ----------
    study
        With nodes called ``plant`` and ``controller``, their objects those of our packages.
    effort
        How many cuts.
    """

    def __init__(self, study: Study, effort: Effort = Effort()) -> None:
        self.study = study
        self.effort = effort
        self.limit = study.constraints["overshoot"].upper
        constants = {
            key: dict(node.parameters) | dict(node.inprocess_parameters)
            for key, node in study.nodes.items()
        }
        self._plant = build(PlantSettings, asdict(plant_defaults()) | constants[PLANT])
        self._controller = asdict(controller_defaults()) | constants[CONTROLLER]
        samples = reference_velocity(self._plant).size
        self._parameter_names = [item.parameter for item in study.contexts.values()]
        space = study.context_space()
        self._drawn_contexts = space.draw_stratified(
            effort.drawn, np.random.default_rng(np.random.SeedSequence(SEED, spawn_key=(0,)))
        )
        axes = [np.linspace(0.0, 1.0, effort.grid)] * space.dimension
        cube = np.array(np.meshgrid(*axes, indexing="ij")).reshape(space.dimension, -1).T
        self.grid_contexts: Array = space.to_contexts(cube)
        deviation = self._plant.noise_variance**0.5
        rng = np.random.default_rng(np.random.SeedSequence(SEED, spawn_key=(1,)))
        self._drawn_noise = rng.normal(0.0, deviation, (effort.drawn, samples))
        self._grid_noise = rng.normal(
            0.0, deviation, (len(self.grid_contexts), effort.noise, samples)
        )
        self._more_noise = rng.normal(0.0, deviation, (effort.more_noise, samples))
        self.corners = np.flatnonzero(np.isin(cube, (0.0, 1.0)).all(axis=1))

    def settings(self, parameters: Mapping[str, Value]) -> ControllerSettings:
        """Put the study's parameters into the controller's settings."""
        values = {self.study.parameters[k].parameter: v for k, v in parameters.items()}
        return build(ControllerSettings, self._controller | values)

    def judge(self, parameters: Mapping[str, Value]) -> Judgement:
        """Find the truth of a parametrization."""
        C, overshoot = self.drawn(parameters)
        means = self.grid_overshoot(parameters)
        worst_first = np.argsort(-np.where(np.isnan(means), np.inf, means), kind="stable")
        candidates = worst_first[: self.effort.candidates].tolist()
        return Judgement(
            E=float(C.mean()),
            standard_error=float(C.std(ddof=1) / np.sqrt(len(C))),
            worst=float(means[candidates[0]]),
            worst_context=self.study.context_space().to_dict(self.grid_contexts[candidates[0]]),
            worst_precise=max(self._precise_overshoot(parameters, c) for c in candidates),
            single_violation=float(np.mean(~(overshoot <= self.limit))),
        )

    def drawn(self, parameters: Mapping[str, Value]) -> tuple[Array, Array]:
        """Tracking errors and overshoots in the drawn contexts, each (drawn,)."""
        result = self._drawn_batch.run(self.settings(parameters))
        return result.tracking_error, result.overshoot

    def grid_overshoot(self, parameters: Mapping[str, Value]) -> Array:
        """Mean overshoot [m/s] over noise in each context of the grid, shape (contexts,)."""
        overshoot = self._grid_batch.run(self.settings(parameters)).overshoot
        means: Array = overshoot.reshape(len(self.grid_contexts), -1).mean(axis=1)
        return means

    def corner_overshoot(self, parameters: Mapping[str, Value]) -> float:
        """Largest mean overshoot [m/s] of the grid's corners only: most infeasible points show."""
        overshoot = self._corner_batch.run(self.settings(parameters)).overshoot
        return float(overshoot.reshape(len(self.corners), -1).mean(axis=1).max())

    def rough(self, parameters: Mapping[str, Value]) -> tuple[float, float]:
        """Tracking error of every tenth drawn context and `corner_overshoot`, cheaper together."""
        result = self._rough_batch.run(self.settings(parameters))
        corners = len(self.corners) * self.effort.noise
        means = result.overshoot[:corners].reshape(len(self.corners), -1).mean(axis=1)
        return float(result.tracking_error[corners:].mean()), float(means.max())

    def _precise_overshoot(self, parameters: Mapping[str, Value], context: int) -> float:
        if context not in self._precise_batches:
            rows = np.repeat(self.grid_contexts[[context]], self.effort.more_noise, axis=0)
            self._precise_batches[context] = CutBatch(
                self._plant, self._columns(rows), self._more_noise
            )
        batch = self._precise_batches[context]
        return float(batch.run(self.settings(parameters)).overshoot.mean())

    def meets_chances(self, parameters: Mapping[str, Value]) -> tuple[bool, dict[str, float]]:
        """Whether the chance constraints hold over real cuts, and the shares within the limits."""
        backend = InProcessBackend(self.study)
        backend.open()
        space = self.study.context_space()
        chances = self.study.chance_constraints
        within = {c.name: 0 for c in chances}
        order = np.linspace(0, self.effort.drawn - 1, self.effort.real_cuts).astype(int)
        for number, row in enumerate(order):
            context = space.to_dict(self._drawn_contexts[row])
            cut = run_cut(self.study, backend, parameters, context, SEED + number)
            for constraint in chances:
                good = cut.state is CutState.COMPLETE
                within[constraint.name] += (
                    good and cut.metrics[constraint.metric] <= constraint.upper
                )
        shares = {name: count / len(order) for name, count in within.items()}
        return all(shares[c.name] >= (c.probability or 1.0) for c in chances), shares

    @cached_property
    def _drawn_batch(self) -> CutBatch:
        return CutBatch(self._plant, self._columns(self._drawn_contexts), self._drawn_noise)

    @cached_property
    def _grid_batch(self) -> CutBatch:
        rows = np.repeat(self.grid_contexts, self.effort.noise, axis=0)
        noise = self._grid_noise.reshape(len(rows), -1)
        return CutBatch(self._plant, self._columns(rows), noise)

    @cached_property
    def _corner_batch(self) -> CutBatch:
        rows = np.repeat(self.grid_contexts[self.corners], self.effort.noise, axis=0)
        noise = self._grid_noise[self.corners].reshape(len(rows), -1)
        return CutBatch(self._plant, self._columns(rows), noise)

    @cached_property
    def _rough_batch(self) -> CutBatch:
        corners = np.repeat(self.grid_contexts[self.corners], self.effort.noise, axis=0)
        noise = self._grid_noise[self.corners].reshape(len(corners), -1)
        return CutBatch(
            self._plant,
            self._columns(np.vstack([corners, self._drawn_contexts[::10]])),
            np.vstack([noise, self._drawn_noise[::10]]),
        )

    @cached_property
    def _precise_batches(self) -> dict[int, CutBatch]:
        return {}

    def _columns(self, contexts: Array) -> dict[str, Array]:
        return {name: contexts[:, i] for i, name in enumerate(self._parameter_names)}
