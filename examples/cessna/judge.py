"""Judges gains on a dense grid of conditions, with neither ROS nor the tuner.

Of the node it shares the simulated aircraft only: the loop and the metrics are written anew here,
so a mistake in one of them shows as a difference. The set-points come at once, where those of the
node come when their message does.
"""

import itertools
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from aircraft import START_ALTITUDE, Aircraft, Conditions, default_gains
from numpy.typing import NDArray

Gains = Mapping[str, float]

TUNED = ("heading_lag", "bank_p", "bank_d", "climb_lag", "climb_p", "climb_i")
DEFAULT: Gains = {name: default_gains()[name] for name in TUNED}
"""JSBSim's for this aircraft."""
ALTITUDE, HEADING = 290.0, 2.0  # to be held from the start on [m], [rad]
CLIMB, TURN = 30.0, 0.5  # [m], [rad]
DURATION = 40.0  # [s]
PERIOD = 0.1  # from one measurement to the next [s]
LOWEST = 200.0  # below it a flight has failed [m]

RANGES = {"wind": (0, 15), "airspeed": (46, 56), "luggage": (0, 80), "wing_load": (0, 60)}


@dataclass(frozen=True)
class Judgement:
    """What became of one flight.

    Attributes
    ----------
    error : float
        Mean over time of the altitude error over the climb and the heading error over the turn.
    overshoot : float
        How far it went above the wanted altitude [% of the climb].
    aileron_effort, elevator_effort : float
        Sum of all changes of the command.
    crashed : bool
        Whether it went below `LOWEST`.
    """

    error: float
    overshoot: float
    aileron_effort: float
    elevator_effort: float
    crashed: bool


def fly(gains: Gains, conditions: Conditions, delay: float = 0.0) -> NDArray[np.float64]:
    """Fly the climbing turn; the set-points come `delay` [s] late.

    Returns
    -------
    numpy.ndarray
        A row for each measurement: time [s], altitude [m], heading [rad], aileron, elevator.
    """
    aircraft = Aircraft(conditions, gains)
    rows: list[list[float]] = []
    told = False
    while aircraft.time < DURATION:
        if not told and aircraft.time >= delay:
            aircraft.hold(ALTITUDE, HEADING)
            told = True
        if aircraft.time >= len(rows) * PERIOD:
            seen = aircraft.measure()
            names = ("altitude", "heading", "aileron", "elevator")
            rows.append([aircraft.time, *(seen[name] for name in names)])
            if seen["altitude"] < LOWEST:
                break
        aircraft.step()
    return np.array(rows)


def judge(gains: Gains, conditions: Conditions, delay: float = 0.0) -> Judgement:
    """Fly once and measure."""
    _, altitude, heading, aileron, elevator = fly(gains, conditions, delay).T
    error = np.abs(altitude - ALTITUDE) / CLIMB + np.abs(heading - HEADING) / TURN
    return Judgement(
        error=float(error.mean()),
        overshoot=100.0 * max(float(altitude.max() - ALTITUDE) / (ALTITUDE - START_ALTITUDE), 0.0),
        aileron_effort=float(np.abs(np.diff(aileron)).sum()),
        elevator_effort=float(np.abs(np.diff(elevator)).sum()),
        crashed=bool(altitude.min() < LOWEST),
    )


def grid(sparse: bool = False) -> list[Conditions]:
    """Return the conditions: every combination, each with a turbulence of its own.

    Three levels of each, or in a `sparse` one two of the loads.
    """
    levels = [
        np.linspace(low, high, 2 if sparse and "load" in name else 3)
        for name, (low, high) in RANGES.items()
    ]
    return [
        Conditions(*map(float, values), seed=10_000 + number)
        for number, values in enumerate(itertools.product(*levels))
    ]


def draws(number: int, seed: int = 2016) -> list[Conditions]:
    """Return conditions drawn as the study says, each with a turbulence of its own."""
    rng = np.random.default_rng(seed)
    return [
        Conditions(*(float(rng.uniform(*limits)) for limits in RANGES.values()), seed=30_000 + i)
        for i in range(number)
    ]
