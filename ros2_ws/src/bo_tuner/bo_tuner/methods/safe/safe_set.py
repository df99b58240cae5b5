"""Which parameter sets are expected to be safe, and which are within reach.

A parameter set x is safe if each limit is kept by a single run in the most doubtful context with a
probability of 1 - `risk`, and this itself is sure to `CONFIDENCE`. With the predicted quantile
q(x, c) of runs in the context c, its standard deviation s(x, c) and the limit L:

    max_c q(x, c) + t s(x, c) <= L

where t is the `CONFIDENCE` quantile of the normal distribution, or the `AMONG_FEW` quantile of
Student's with as many degrees of freedom as parameter sets were tried, if that is larger: the
spread and the length scales of a process are learnt from these, and from few of them its own
deviation is too small.

This is the safe set of SafeOpt (Sui et al. 2015, Algorithm 1) without a Lipschitz constant, by the
confidence interval of the process itself (Berkenkamp et al. 2016), where what is limited is a
quantile of noisy runs in the context where that is most doubtful. No limit is taken for another:
each has to hold.

A model says little of places far from its data. So parameter sets are also within reach of one that
was tried and has kept its limits: each number at most `travel` away, and a boolean or a choice
differs only where all else is equal. (Xopt limits a step by `max_travel_distances`.)

References
----------
Sui, Gotovos, Burdick and Krause (2015). Safe exploration for optimization with Gaussian processes.
ICML.
Berkenkamp, Schoellig and Krause (2016). Safe controller optimization for quadrotors with Gaussian
processes. ICRA.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri, stdtrit

from bo_tuner.models.pooled_models import PooledSurrogates
from bo_tuner.models.pooled_responses import PooledResponse
from bo_tuner.numerics.arrays import Array
from bo_tuner.numerics.special import log_normal_cdf
from bo_tuner.study.search_space import SearchSpace
from bo_tuner.study.study import Study
from bo_tuner.trials import Trial

CONFIDENCE = 0.999
"""How sure it must be that a run keeps a limit with the probability that it must."""

AMONG_FEW = 0.997
"""The same while few parameter sets were tried, with the quantile of Student's distribution."""

CANDIDATES = 1500
"""Random points within reach among which the next one is chosen."""


@dataclass(frozen=True, eq=False)
class SafeSet:
    """The parameter sets that are expected to be safe.

    Attributes
    ----------
    surrogates
        Models of all evaluations.
    risk
        Largest probability with which a run may break a limit.
    """

    surrogates: PooledSurrogates
    risk: float

    @cached_property
    def limits(self) -> dict[str, PooledResponse]:
        """The limits on single runs, by the names of the constraints."""
        level = 1.0 - self.risk
        return {name: c.on_runs(level) for name, c in self.surrogates.constraints.items()}

    def contains(self, x: Array) -> NDArray[np.bool_]:
        """Return which (m,) of the points x (m, d) are safe."""
        log_least = self._log_least
        log_complement = self.surrogates.crashes.log_complement(x)
        safe: NDArray[np.bool_] = log_complement >= np.log1p(-self.risk)
        for limit in self.limits.values():
            rows = np.flatnonzero(safe)
            # Where the mean is beyond the limit no uncertainty need be computed.
            rows = rows[limit.excess(x[rows]) <= 0.0] if len(rows) else rows
            kept = rows[limit.least_log_probability(x[rows]) >= log_least]
            safe = np.zeros(len(x), dtype=bool)
            safe[kept] = True
        return safe

    @property
    def _log_least(self) -> float:
        """Least log probability of a limit that is kept: log Φ(t)."""
        objective = self.surrogates.objective
        tried = 1 if objective is None else len(objective.points)
        t = max(ndtri(CONFIDENCE), stdtrit(tried, AMONG_FEW))
        return float(log_normal_cdf(t))

    def uncertainty(self, x: Array) -> Array:
        """Return the largest standard deviation (m,) of a limited quantile at x (m, d).

        Each relative to its largest one among x, since the limits have different units.
        """
        largest = np.zeros(len(x))
        if not len(x):
            return largest
        for limit in self.limits.values():
            deviation = np.sqrt(limit.predict(x)[1])
            largest = np.maximum(largest, deviation / max(deviation.max(), np.finfo(float).tiny))
        return largest

    def most_doubtful(self, x: Array) -> tuple[str, float]:
        """Return the limit that is least sure to be kept, and how sure, where that is highest.

        Parameters
        ----------
        x : ndarray, shape (m, d)
            Points; the one is taken at which the least sure limit is most sure.
        """
        names = list(self.limits)
        log_sure = np.array([limit.least_log_probability(x) for limit in self.limits.values()])
        best = int(log_sure.min(axis=0).argmax())
        least = int(log_sure[:, best].argmin())
        return names[least], float(np.exp(log_sure[least, best]))


@dataclass(frozen=True, eq=False)
class Reach:
    """What is within reach of the parameter sets that were tried and have kept their limits.

    Attributes
    ----------
    space
        The search space.
    kept
        Trials of these parameter sets, at least one.
    travel : ndarray, shape (d,)
        Largest distance of each number in the unit cube.
    dependent
        The same, by name, of those that follow from an equality of others.
    """

    space: SearchSpace
    kept: Sequence[Trial]
    travel: Array
    dependent: Mapping[str, float] = field(default_factory=dict)

    @classmethod
    def of(cls, study: Study, kept: Sequence[Trial], travel: float, trust: float) -> "Reach":
        """Return the reach in a study, less with less trust; `travel` is that of most numbers."""
        space = study.search_space()
        own = {name: study.parameters[name].travel for name in study.tuned_names}
        reach = {name: trust * (travel if t is None else t) for name, t in own.items()}
        names = space.names
        beside = {name: reach[name] for name in reach.keys() - set(names)}
        return cls(space, kept, np.array([reach[name] for name in names]), beside)

    def candidates(self, towards: Array, rng: np.random.Generator) -> Array:
        """Draw points (m, d) within reach, some of them in a straight line to a point (d,)."""
        centres = self.space.cube_of(trial.parameters for trial in self.kept)
        chosen = centres[rng.integers(len(centres), size=CANDIDATES)]
        # Steps of all lengths, so that some are short in all directions at once.
        length = rng.random((CANDIDATES, 1))
        away = rng.uniform(-1.0, 1.0, chosen.shape) * length * self.travel
        line = np.clip(towards - centres, -self.travel, self.travel)
        shares = np.linspace(0.1, 1.0, 10)[:, None, None]
        ahead = (centres + shares * line).reshape(-1, centres.shape[1])
        numbers = np.isin(self.space.names, self.space.numbers)
        drawn = np.vstack([np.where(numbers, chosen + away, chosen), ahead])
        owners = np.vstack([chosen, np.tile(centres, (len(shares), 1))])
        drawn[:, ~numbers] = owners[:, ~numbers]
        drawn = self.space.repair(drawn)
        # The repair may move a point farther, for the sake of order or of a condition.
        near = (np.abs(drawn - owners) <= self.travel + 1e-9) | (drawn == owners)
        near[:, ~numbers] = drawn[:, ~numbers] == owners[:, ~numbers]
        before = self.space.dependent(owners)
        for name, after in self.space.dependent(drawn).items():
            # What follows from others may go farther than each of them.
            near &= (np.abs(after - before[name]) <= self.dependent[name] + 1e-9)[:, None]
        steps = [p for t in self.kept for p in self.space.integer_neighbours(t.parameters)]
        return np.vstack([drawn[near.all(axis=1)], self.space.cube_of(steps)])
