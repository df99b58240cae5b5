"""How far a machine is from its simulation, by the models of both."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from bo_tuner.models.context_process import ContextProcess
from bo_tuner.models.simulation import SIMULATED
from bo_tuner.numerics.arrays import Array

DEVIATIONS = 1.959964
"""Half width of a 95 % interval, in standard deviations."""


@dataclass(frozen=True)
class Bias:
    """What the machine has more of a metric than its simulation, in the metric's unit.

    Means over noise and over the distribution of the contexts.

    Attributes
    ----------
    metric
        Its name.
    simulated
        In the simulation.
    low, difference, high
        Machine less simulation, with a 95 % interval.
    """

    metric: str
    simulated: float
    low: float
    difference: float
    high: float


@dataclass(frozen=True, eq=False)
class Comparison:
    """A metric of a machine beside that of its simulation.

    Attributes
    ----------
    process
        Of both, on the scale of the model; runs of the simulation have the offset on top.
    contexts : ndarray, shape (k, e + w')
        Drawn contexts, with the further columns of the machine; the last says that it is one.
    offset
        What the machine was taken to have more at all parameter sets, on that scale.
    restore
        From that scale to the metric's unit.
    """

    process: ContextProcess
    contexts: Array
    offset: float
    restore: Callable[[Array], Array]

    def bias(self, metric: str, x: Array) -> Bias:
        """Return the bias at a parameter set x (1, d)."""
        simulated = self.contexts.copy()
        simulated[:, -1] = SIMULATED
        k = len(simulated)
        weights = np.repeat([1.0 / k, -1.0 / k], k)[None]
        both = np.vstack([self.contexts, simulated])
        reach = DEVIATIONS * np.sqrt(self.process.variance_of_weighted(x, both, weights, 0.0)[0])
        machine = float(self.process.means(x, self.contexts).mean())
        simulation = float(self.process.means(x, simulated).mean()) - self.offset
        ends = np.array([simulation, machine - reach, machine, machine + reach])
        own, low, middle, high = self.restore(ends)
        # A cost that is to be maximized has the opposite sign.
        low, high = sorted((low - own, high - own))
        return Bias(metric, float(own), float(low), float(middle - own), float(high))
