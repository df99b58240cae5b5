"""Judges gains on a dense grid of conditions, with neither ROS nor the tuner.

Of the nodes it shares the simulated flight only: the loop, the metrics and the controller's set-up
are written anew here, so a mistake in one of them shows as a difference.
"""

import itertools
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from flight import PERIOD, START_HEIGHT, Conditions, Flight
from numpy.typing import NDArray
from rotorpy.controllers.quadrotor_control import SE3Control
from rotorpy.vehicles import crazyflie_params

Gains = Mapping[str, float]

DEFAULT: Gains = {
    "kp_xy": 6.5, "kd_xy": 4.0, "kp_z": 15.0, "kd_z": 9.0, "kp_att": 310.0, "kd_att": 57.0,
}  # fmt: skip
"""RotorPy 3.0's for the Crazyflie; a test compares them with the package."""
GOAL = np.array([1.0, 0.0, START_HEIGHT + 0.5])
DURATION = 4.0  # [s]
CRASH_DISTANCE = 5.0  # horizontally, from the start [m]

WIND_SPEEDS = (0.0, 1.5, 3.0)
WIND_DIRECTIONS = tuple(np.arange(-4, 4) * np.pi / 4)
PAYLOADS = (0.0, 0.006)
MOTOR_TIME_CONSTANTS = (0.05, 0.072, 0.09)


@dataclass(frozen=True)
class Judgement:
    """What became of one flight.

    Attributes
    ----------
    error : float
        Mean distance from the goal [m].
    overshoot : float
        How far it went beyond the goal along the step [%].
    effort : float
        Sum of all changes of the wanted speed of the first rotor [rad/s].
    crashed : bool
        Whether it touched the ground or flew away.
    """

    error: float
    overshoot: float
    effort: float
    crashed: bool


def fly(
    gains: Gains, conditions: Conditions
) -> tuple[NDArray[np.float64], NDArray[np.float64], bool]:
    """Fly the step.

    Returns
    -------
    tuple
        Measured positions (n, 3) [m], wanted rotor speeds (n, 4) [rad/s], whether it crashed.
    """
    flight, control = Flight(conditions), SE3Control(crazyflie_params.quad_params)
    control.kp_pos = np.array([gains["kp_xy"], gains["kp_xy"], gains["kp_z"]])
    control.kd_pos = np.array([gains["kd_xy"], gains["kd_xy"], gains["kd_z"]])
    control.kp_att, control.kd_att = gains["kp_att"], gains["kd_att"]
    wanted = {"x": GOAL, "x_dot": np.zeros(3), "x_ddot": np.zeros(3), "yaw": 0.0, "yaw_dot": 0.0}
    positions, speeds = [], []
    for _ in range(round(DURATION / PERIOD)):
        seen = flight.measure()
        command = control.update(flight.time, seen, wanted)["cmd_motor_speeds"]
        positions.append(seen["x"])
        speeds.append(command)
        x, y, z = seen["x"]
        if z < 0.0 or np.hypot(x, y) > CRASH_DISTANCE:
            return np.array(positions), np.array(speeds), True
        flight.step(command)
    return np.array(positions), np.array(speeds), False


def judge(gains: Gains, conditions: Conditions) -> Judgement:
    """Fly once and measure."""
    positions, speeds, crashed = fly(gains, conditions)
    return Judgement(
        error=float(np.linalg.norm(positions - GOAL, axis=1).mean()),
        overshoot=100.0 * max(float(positions[:, 0].max() / GOAL[0]) - 1.0, 0.0),
        effort=float(np.abs(np.diff(speeds[:, 0])).sum()),
        crashed=crashed,
    )


def grid(sparse: bool = False) -> list[Conditions]:
    """Return the conditions: every combination, each with gusts and noise of its own.

    A `sparse` one has the extremes of wind speed and motors only, still from all directions.
    """
    step = 2 if sparse else 1
    calm = [(0.0, 0.0)]
    windy = list(itertools.product(WIND_SPEEDS[step::step], WIND_DIRECTIONS))
    combinations = itertools.product(calm + windy, PAYLOADS, MOTOR_TIME_CONSTANTS[::step])
    return [
        Conditions(
            wind_speed=speed,
            wind_direction=direction,
            payload=payload,
            motor_time_constant=lag,
            seed=10_000 + number,
        )
        for number, ((speed, direction), payload, lag) in enumerate(combinations)
    ]


def draws(number: int, seed: int = 2016) -> list[Conditions]:
    """Return conditions drawn as the study says, each with gusts and noise of its own."""
    rng = np.random.default_rng(seed)
    return [
        Conditions(
            wind_speed=float(rng.uniform(0.0, WIND_SPEEDS[-1])),
            wind_direction=float(rng.uniform(-np.pi, np.pi)),
            payload=float(rng.uniform(*PAYLOADS)),
            motor_time_constant=float(
                rng.uniform(MOTOR_TIME_CONSTANTS[0], MOTOR_TIME_CONSTANTS[-1])
            ),
            seed=30_000 + i,
        )
        for i in range(number)
    ]
