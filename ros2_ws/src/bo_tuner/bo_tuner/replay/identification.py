"""Where in its context box a machine is, by a few of its runs and a simulator.

The simulator is run at the parameter sets of the machine's runs, over a design of contexts; then
again in contexts of the posterior, where it matters what it gives.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from bo_tuner.errors import RunRecordError
from bo_tuner.models.context_posterior import (
    LEAST_SIMULATED,
    ContextPosterior,
    Emulator,
    MisfitTest,
    RealRuns,
    infer_context,
    noise_of,
)
from bo_tuner.numerics.arrays import Array
from bo_tuner.numerics.latin_hypercube import latin_hypercube
from bo_tuner.numerics.seeds import Stream, generator, noise_seed
from bo_tuner.plans import Runs
from bo_tuner.replay.machine_runs import MachineRuns
from bo_tuner.study.study import Study
from bo_tuner.trials import Evaluation, ParameterSet, Stage
from bo_tuner.tuning.driver import Driver

WAVES = 2
"""Designs of contexts: of the box, and of the posterior by what the one before has shown."""
SIMULATIONS = 50
"""Runs of the simulator at each parameter set in each design, unless asked for."""
MOST_SETS = 20
"""Parameter sets of a machine's runs, at most: each takes simulations of its own."""


@dataclass(frozen=True)
class Identification:
    """The contexts in which a machine may be.

    Attributes
    ----------
    study
        Of the simulator; its contexts are the box.
    posterior
        The contexts.
    metrics
        What was compared, in the order of the tests.
    simulated
        Number of runs of the simulator.
    """

    study: Study
    posterior: ContextPosterior
    metrics: tuple[str, ...]
    simulated: int

    def misfits(self, level: float) -> list[str]:
        """Return in a sentence each what no context explains, at a level of all tests together."""
        return [self._misfit(test) for test in self.posterior.misfits(level)]

    def _misfit(self, test: MisfitTest) -> str:
        p_value = f"p = {test.p_value:.2g}"
        if test.metric is None:
            return f"the metrics do not fit together ({p_value})"
        name = self.metrics[test.metric]
        if test.of_scatter:
            return (
                f"{name}: equal runs of the machine differ {test.deviations:.3g} times as much as "
                f"those of the simulator ({p_value})"
            )
        side = "above" if test.deviations > 0.0 else "below"
        return (
            f"{name}: {abs(test.deviations):.2g} standard deviations {side} that of the simulator "
            f"({p_value})"
        )


def identify(
    study: Study, machine: MachineRuns, driver: Driver, simulations: int = SIMULATIONS
) -> Identification:
    """Infer the context of a machine."""
    space = study.context_space()
    scale = _Scale(study, machine)
    rng = generator(study.seed, Stream.IDENTIFICATION)
    real = [RealRuns(scale.of(runs)) for runs in machine.sets.values()]
    noise = None if study.seed_parameter is not None else _noise(real)
    design = space.to_contexts(latin_hypercube(simulations, space.dimension, rng))
    known: dict[ParameterSet, list[Evaluation]] = {key: [] for key in machine.sets}
    for wave in range(WAVES):
        planned = _planned(study, machine, design, wave)
        plan = Runs(planned, "simulations")
        driver.complete(plan)
        for evaluation in plan.evaluations:
            known[evaluation.parameter_set].append(evaluation)
        emulators = [
            _emulator(study, runs, simulations, scale, noise, rng) for runs in known.values()
        ]
        posterior = infer_context(space, emulators, real, rng)
        chosen = rng.choice(len(posterior.contexts), simulations, replace=False)
        design = posterior.contexts[chosen]
    return Identification(study, posterior, machine.metrics, sum(map(len, known.values())))


def _noise(real: list[RealRuns]) -> Array:
    """Return the noise of the machine, which stands for that of a simulator that has none."""
    try:
        return noise_of(real)
    except ValueError as error:
        raise RunRecordError(
            f"the simulator has no noise (no seed_parameter), and that of the machine is not "
            f"known: {error}"
        ) from error


def _planned(study: Study, machine: MachineRuns, design: Array, wave: int) -> list[Evaluation]:
    """Return the runs of a design (n, v) of contexts at each parameter set."""
    contexts = [study.context_space().to_dict(row) for row in design]
    return [
        Evaluation(
            trial,
            wave * len(contexts) + k,
            Stage.SEARCH,
            dict(key),
            context,
            noise_seed(study.seed, Stream.IDENTIFICATION, wave, trial, k),
        )
        for trial, key in enumerate(machine.sets)
        for k, context in enumerate(contexts)
    ]


def _emulator(
    study: Study,
    runs: list[Evaluation],
    latest: int,
    scale: "_Scale",
    noise: Array | None,
    rng: np.random.Generator,
) -> Emulator:
    """Return the emulator of runs at one parameter set, with the noise of the `latest` ones."""
    complete = [run for run in runs if run.outcome.complete]
    if len(complete) < max(LEAST_SIMULATED, len(runs) // 2):
        reason = next(run.outcome.reason for run in runs if not run.outcome.complete)
        raise RunRecordError(
            f"the simulator fails in {len(runs) - len(complete)} of {len(runs)} contexts at "
            f"parameters of the machine: {reason}"
        )
    cube = study.context_space().cube_of([run.context for run in complete])
    values = scale.of([run.outcome.metrics for run in complete])
    of_latest = sum(run.outcome.complete for run in runs[-latest:])
    emulator = Emulator.fit(cube, values, rng, max(of_latest, LEAST_SIMULATED))
    return emulator if noise is None else replace(emulator, noise=noise)


class _Scale:
    """Metrics on their scales: logarithms of those that vary in proportion."""

    def __init__(self, study: Study, machine: MachineRuns) -> None:
        self._names = machine.metrics
        values = [run for runs in machine.sets.values() for run in runs]
        logarithmic = study.logarithmic_metrics
        self._logarithmic = [
            name in logarithmic and all(run[name] > 0.0 for run in values) for name in self._names
        ]

    def of(self, runs: Sequence[Mapping[str, float]]) -> Array:
        """Return the metrics (n, k) of n runs."""
        values = np.array([[run[name] for name in self._names] for run in runs])
        smallest = np.finfo(float).tiny
        return np.where(self._logarithmic, np.log(np.maximum(values, smallest)), values)
