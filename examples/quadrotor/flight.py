"""A Crazyflie in wind: dynamics, rotor drag and motion capture of RotorPy, without ROS.

The wind is a mean, horizontal, and gusts about it. RotorPy 3.0 has Dryden gusts, but imports torch
for them; here they are the longitudinal Dryden filter in its state-space form (MIL-F-8785C, low
altitude), white noise through a first-order lag of the time L/V.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from rotorpy.sensors.external_mocap import MotionCapture
from rotorpy.vehicles import crazyflie_params
from rotorpy.vehicles.multirotor import Multirotor

PERIOD = 0.01
"""Time [s] from one measurement to the next; RotorPy's own."""
INTEGRATOR = {"method": "RK23", "first_step": PERIOD}
"""Of RotorPy's dynamics: one step a period, in half the time of its default (RK45)."""
GUST_LENGTH, AIRSPEED = 5.0, 3.0  # L [m], V [m/s] of the Dryden filter
START_HEIGHT = 1.0  # [m]

State = dict[str, NDArray[np.float64]]


@dataclass(frozen=True)
class Conditions:
    """What a flight meets.

    Attributes
    ----------
    wind_speed, wind_direction : float
        Mean wind [m/s], and where it blows to, from x to y [rad].
    gust : float
        Standard deviation of the gusts in each direction [m/s].
    payload : float
        Mass that hangs at the centre of mass [kg].
    motor_time_constant : float
        Of the rotor speeds [s].
    seed : int
        Of gusts and measurement noise.
    """

    wind_speed: float = 0.0
    wind_direction: float = 0.0
    gust: float = 0.2
    payload: float = 0.0
    motor_time_constant: float = crazyflie_params.quad_params["tau_m"]
    seed: int = 0


class Flight:
    """One flight from hover at `START_HEIGHT`.

    Parameters
    ----------
    conditions
        What it meets.

    Attributes
    ----------
    time : float
        Time [s] since its start.
    state : dict
        RotorPy's state: `x` (3,) [m], `v` (3,) [m/s], `q` (4,), `w` (3,) [rad/s], `wind` (3,)
        [m/s], `rotor_speeds` (4,) [rad/s].
    """

    def __init__(self, conditions: Conditions) -> None:
        self._conditions = conditions
        vehicle = crazyflie_params.quad_params | {
            "mass": crazyflie_params.quad_params["mass"] + conditions.payload,
            "tau_m": conditions.motor_time_constant,
        }
        hover = math.sqrt(vehicle["mass"] * 9.81 / (4 * vehicle["k_eta"]))
        self._rng = np.random.default_rng(conditions.seed)
        # RotorPy's sensor draws from the global generator.
        np.random.seed(conditions.seed % 2**32)  # noqa: NPY002
        self._gust = conditions.gust * self._rng.standard_normal(3)
        self.state: State = {
            "x": np.array([0.0, 0.0, START_HEIGHT]),
            "v": np.zeros(3),
            "q": np.array([0.0, 0.0, 0.0, 1.0]),
            "w": np.zeros(3),
            "wind": self._wind(),
            "rotor_speeds": np.full(4, hover),
        }
        self._vehicle = Multirotor(vehicle, self.state, integrator_kwargs=INTEGRATOR)
        self._sensor = MotionCapture(1.0 / PERIOD)
        self._steps = 0

    @property
    def time(self) -> float:
        """Time [s] since its start."""
        return self._steps * PERIOD

    def measure(self) -> State:
        """Return `x`, `v`, `q`, `w` as a motion capture system sees them."""
        return self._sensor.measurement(self.state, with_noise=True)

    def step(self, rotor_speeds: NDArray[np.float64]) -> None:
        """Go on for `PERIOD` with the wanted rotor speeds (4,) [rad/s]."""
        self.state = self._vehicle.step(self.state, {"cmd_motor_speeds": rotor_speeds}, PERIOD)
        decay = math.exp(-PERIOD * AIRSPEED / GUST_LENGTH)
        noise = self._conditions.gust * self._rng.standard_normal(3)
        self._gust = decay * self._gust + math.sqrt(1.0 - decay**2) * noise
        self.state["wind"] = self._wind()
        self._steps += 1

    def _wind(self) -> NDArray[np.float64]:
        speed, direction = self._conditions.wind_speed, self._conditions.wind_direction
        mean = speed * np.array([math.cos(direction), math.sin(direction), 0.0])
        return mean + self._gust
