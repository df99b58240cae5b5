"""Random metrics of a context whose worst mean is known, with noise that may depend on the context.

The mean is a function of e context variables in the unit cube, of one of the kinds of `KINDS`; none
is a sample of the certificate's own model. It is scaled to a mean of 0 and a standard deviation of
1 over the cube. Its maximum is found on a grid and refined from there.

References
----------
Rahimi and Recht (2007). Random features for large-scale kernel machines. NeurIPS 20.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

Array = NDArray[np.float64]
Function = Callable[[Array], Array]
"""Maps points (n, e) of the unit cube to values (n,)."""

FEATURES = 200
"""Random features of a sample of a stationary process."""

GRID = {1: 2001, 2: 101, 3: 33}
"""Points of the grid along each axis, by the number of variables."""

REFINED = 12
"""Grid points from which the maximum is refined."""

NOISE = 0.03, 0.4
"""Least and largest standard deviation of the noise in the middle of its range."""

LOUDER = 4.0
"""Largest ratio of the standard deviations of noise that depends on the context."""


def rough(degrees: float) -> Callable[[np.random.Generator, int], Function]:
    """Make samples of a process with a Matérn kernel; smooth (squared exponential) if infinite.

    Its spectral density is that of Student's t distribution with twice its smoothness as degrees of
    freedom, or the normal one.
    """

    def make(rng: np.random.Generator, dimension: int) -> Function:
        scales = np.exp(rng.uniform(np.log(0.3), np.log(2.0), dimension))
        frequencies = rng.standard_normal((FEATURES, dimension))
        if np.isfinite(degrees):
            frequencies /= np.sqrt(rng.chisquare(degrees, (FEATURES, 1)) / degrees)
        frequencies /= scales
        phases, weights = rng.uniform(0.0, 2.0 * np.pi, FEATURES), rng.standard_normal(FEATURES)
        return lambda u: np.cos(u @ frequencies.T + phases) @ weights

    return make


def polynomial(rng: np.random.Generator, dimension: int) -> Function:
    """Make a polynomial of the third order with all products of two variables."""
    linear, cubic = rng.standard_normal((2, dimension))
    products = rng.standard_normal((dimension, dimension))

    def function(u: Array) -> Array:
        x = 2.0 * u - 1.0
        quadratic = np.einsum("ni,ij,nj->n", x, products, x)
        return x @ linear + quadratic + x**3 @ cubic

    return function


def kink(rng: np.random.Generator, dimension: int) -> Function:
    """Make the largest of four planes."""
    slopes, shifts = rng.standard_normal((4, dimension)), 0.5 * rng.standard_normal(4)
    return lambda u: ((2.0 * u - 1.0) @ slopes.T + shifts).max(axis=1)


def resonance(rng: np.random.Generator, dimension: int) -> Function:
    """Make a peak along a ridge, as of an amplitude over a frequency, with a tilt."""
    direction, tilt = rng.standard_normal((2, dimension))
    direction /= np.linalg.norm(direction)
    place, width = rng.uniform(0.2, 0.8), rng.uniform(0.15, 0.5)

    def function(u: Array) -> Array:
        along = (u - 0.5) @ direction + 0.5
        return 1.0 / (1.0 + ((along - place) / width) ** 2) + 0.3 * (u @ tilt)

    return function


def saturation(rng: np.random.Generator, dimension: int) -> Function:
    """Make a monotonic function that levels off."""
    slopes = rng.standard_normal(dimension)
    place, width = rng.uniform(-0.5, 0.5), rng.uniform(0.1, 0.6)
    return lambda u: np.tanh(((u - 0.5) @ slopes - place) / width) + 0.1 * (u @ slopes)


KINDS = {
    "smooth": rough(np.inf),
    "Matérn 5/2": rough(5.0),
    "Matérn 3/2": rough(3.0),
    "polynomial": polynomial,
    "kink": kink,
    "resonance": resonance,
    "saturation": saturation,
}


@dataclass(frozen=True)
class Response:
    """A random metric.

    Attributes
    ----------
    kind
        Key of `KINDS`.
    dimension
        Number of context variables, e.
    heteroscedastic
        Whether the noise depends on the context.
    mean, deviation
        Mean and standard deviation of the metric at points of the unit cube.
    worst, where
        The largest mean, and its point (e,).
    """

    kind: str
    dimension: int
    heteroscedastic: bool
    mean: Function
    deviation: Function
    worst: float
    where: Array


def response(rng: np.random.Generator) -> Response:
    """Draw a response."""
    kind = list(KINDS)[rng.integers(len(KINDS))]
    dimension = int(rng.integers(1, 4))
    heteroscedastic = bool(rng.integers(2))
    raw = KINDS[kind](rng, dimension)
    grid = _grid(dimension)
    values = raw(grid)
    shift, scale = values.mean(), values.std()
    middle = float(np.exp(rng.uniform(*np.log(NOISE))))
    loudness = _loudness(rng, dimension, grid) if heteroscedastic else _equally
    most, where = largest(raw, dimension)
    return Response(
        kind,
        dimension,
        heteroscedastic,
        lambda u: (raw(u) - shift) / scale,
        lambda u: middle * LOUDER ** loudness(u),
        float((most - shift) / scale),
        where,
    )


def largest(function: Function, dimension: int) -> tuple[float, Array]:
    """Return the largest value of a function on the unit cube, and its point (e,)."""
    grid = _grid(dimension)
    values = function(grid)
    found = [
        minimize(lambda u: -function(u[None])[0], start, bounds=[(0.0, 1.0)] * dimension).x
        for start in grid[np.argsort(-values)[:REFINED]]
    ]
    points = np.vstack([grid[[int(np.argmax(values))]], np.clip(found, 0.0, 1.0)])
    where = points[int(np.argmax(function(points)))]
    return float(function(where[None])[0]), where


def _loudness(rng: np.random.Generator, dimension: int, grid: Array) -> Function:
    """Make a smooth function between -1/2 and 1/2."""
    slopes, bend = rng.standard_normal(dimension), rng.standard_normal()

    def raw(u: Array) -> Array:
        return (u - 0.5) @ slopes + bend * ((u - 0.5) ** 2).sum(axis=1)

    low, high = raw(grid).min(), raw(grid).max()
    return lambda u: (raw(u) - low) / (high - low) - 0.5


def _equally(u: Array) -> Array:
    return np.zeros(len(u))


def _grid(dimension: int) -> Array:
    axes = [np.linspace(0.0, 1.0, GRID[dimension])] * dimension
    return np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, dimension)
