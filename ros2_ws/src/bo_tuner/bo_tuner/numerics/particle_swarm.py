"""Particle swarm optimization over the unit cube, vectorized over the particles.

Each particle follows the best of its neighbours on a ring, not the best of all. The logarithm of an
acquisition function has narrow peaks, thousands of units above the rest; on these a swarm that
follows a single leader often converges to the wrong peak.

References
----------
Kennedy and Eberhart (1995). Particle swarm optimization. IEEE ICNN.
Clerc and Kennedy (2002). The particle swarm: explosion, stability, and convergence in a
multidimensional complex space. IEEE Transactions on Evolutionary Computation 6(1).
Kennedy and Mendes (2002). Population structure and particle swarm performance. IEEE CEC.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bo_tuner.numerics.arrays import Array
from bo_tuner.numerics.latin_hypercube import latin_hypercube

Objective = Callable[[Array], Array]
Improvement = Callable[[Array, Array], Array]
Repair = Callable[[Array], Array]

# Clerc and Kennedy's constriction for φ1 = φ2 = 2.05, which ensures convergence.
INERTIA = 0.7298
ATTRACTION = 1.49618
MAXIMUM_VELOCITY = 0.5
# A particle's neighbours on each side of the ring, as a fraction of the swarm.
RING_FRACTION = 0.1


@dataclass(frozen=True)
class SwarmSettings:
    """Effort of a search.

    Attributes
    ----------
    particles : int
        Number of particles, ≥ 1.
    iterations : int
        Largest number of moves, ≥ 1.
    stall : int
        The search stops after this many moves without progress, ≥ 1.
    tolerance : float
        Smallest gain of the best value that counts as progress, ≥ 0.
    """

    particles: int = 100
    iterations: int = 100
    stall: int = 20
    tolerance: float = 1e-3

    def __post_init__(self) -> None:
        """Refuse values out of range."""
        for name in ("particles", "iterations", "stall"):
            if getattr(self, name) < 1:
                raise ValueError(f"{name}: expected at least 1, found {getattr(self, name)}")
        if not self.tolerance >= 0.0:
            raise ValueError(f"tolerance: expected >= 0, found {self.tolerance}")


@dataclass(frozen=True, eq=False)
class SwarmResult:
    """Result of a search.

    Attributes
    ----------
    position : ndarray, shape (d,)
        Best admissible position.
    value : float
        Objective there; -inf if no evaluated position has a larger value.
    """

    position: Array
    value: float


def maximize(
    objective: Objective,
    dimension: int,
    rng: np.random.Generator,
    *,
    improved: Improvement | None = None,
    repair: Repair | None = None,
    initial: Array | None = None,
    settings: SwarmSettings = SwarmSettings(),
) -> SwarmResult:
    """Maximize a function over the unit cube.

    Particles move in the continuous cube, but the objective is evaluated at repaired positions, and
    the best of these are kept. So a particle can cross the cell of an integer in several moves.

    Parameters
    ----------
    objective : callable
        Maps positions, shape (m, d), to values, shape (m,); -inf excludes a position, and NaN
        counts as -inf.
    dimension : int
        Dimension d of the cube.
    rng : numpy.random.Generator
        Draws the start and the moves.
    improved : callable, optional
        Maps values, shape (m,), and positions, shape (m, d), to the objective where it exceeds the
        value; where it does not, to any number up to the value, if that costs less. A particle
        needs to know only whether a position is better than all its positions before.
    repair : callable, optional
        Maps positions, shape (m, d), to the nearest admissible ones (rounded integers, order
        constraints) in the cube.
    initial : ndarray, shape (k, d), optional
        Positions of the first k particles; the others start as a Latin hypercube.
    settings : SwarmSettings, optional

    Raises
    ------
    ValueError
        If `initial` has not d columns.
    """
    admissible = repair if repair is not None else _identity
    position = _start(dimension, rng, initial, settings.particles)
    velocity = rng.uniform(-1.0, 1.0, position.shape) * 0.25

    def compare(known: Array, where: Array) -> Array:
        return objective(where) if improved is None else improved(known, where)

    own_best = admissible(position)
    own_value = _numbers(objective(own_best))
    ring = _ring(len(position))
    reference, stalled = own_value.max(), 0
    for _ in range(settings.iterations):
        leader = ring[np.arange(len(ring)), own_value[ring].argmax(axis=1)]
        position, velocity = _move(position, velocity, own_best, own_best[leader], rng)
        candidate = admissible(position)
        value = _numbers(compare(own_value, candidate))
        better = value > own_value
        own_best = np.where(better[:, None], candidate, own_best)
        own_value = np.where(better, value, own_value)
        if own_value.max() > reference + settings.tolerance:
            reference, stalled = own_value.max(), 0
        else:
            stalled += 1
            if stalled == settings.stall:
                break
    best = int(np.argmax(own_value))
    return SwarmResult(own_best[best].copy(), float(own_value[best]))


def _identity(position: Array) -> Array:
    return position


def _numbers(values: Array) -> Array:
    """Return values (m,), with -inf for NaN."""
    numbers = np.asarray(values, dtype=np.float64)
    return np.where(np.isnan(numbers), -np.inf, numbers)


def _move(
    position: Array, velocity: Array, own_best: Array, leader: Array, rng: np.random.Generator
) -> tuple[Array, Array]:
    """Return the next positions and velocities; all arrays have the shape (m, d)."""
    pull = rng.uniform(0.0, ATTRACTION, (2, *position.shape))
    velocity = INERTIA * velocity + pull[0] * (own_best - position) + pull[1] * (leader - position)
    velocity = np.clip(velocity, -MAXIMUM_VELOCITY, MAXIMUM_VELOCITY)
    moved = position + velocity
    position = np.clip(moved, 0.0, 1.0)
    velocity[position != moved] = 0.0  # a wall absorbs
    return position, velocity


def _ring(count: int) -> NDArray[np.intp]:
    """Return the neighbours of each particle, itself included, shape (count, 2 radius + 1)."""
    radius = max(1, round(RING_FRACTION * count))
    offsets = np.arange(-radius, radius + 1)
    return (np.arange(count)[:, None] + offsets) % count


def _start(dimension: int, rng: np.random.Generator, initial: Array | None, count: int) -> Array:
    """Return the first positions, shape (max(count, k), d)."""
    given = np.empty((0, dimension)) if initial is None else np.asarray(initial, dtype=np.float64)
    if given.ndim != 2 or given.shape[1] != dimension:
        raise ValueError(f"initial: expected shape (k, {dimension}), found {given.shape}")
    rest = max(count - len(given), 0)
    hypercube = latin_hypercube(rest, dimension, rng)
    return np.concatenate([np.clip(given, 0.0, 1.0), hypercube])
