"""A hot plate under a PI controller: what the node does, without ROS."""

from collections import deque
from collections.abc import Mapping

import numpy as np

DEFAULTS: dict[str, float | int] = {
    "kp": 1.0,  # proportional gain [W/K]
    "ki": 0.02,  # integral gain [W/(K s)]
    "average": 5,  # readings of the sensor that are averaged, one a second
    "load": 1.0,  # context: heat capacity against that of the empty plate
    "draught": 1.0,  # context: heat loss against that in still air
    "seed": 0,  # of the sensor's noise
}
AMBIENT, TARGET, CUT_OUT = 20.0, 60.0, 90.0  # [degrees Celsius]
CAPACITY, LOSS, MAX_POWER = 50.0, 0.5, 100.0  # [J/K], [W/K], [W]
DELAY, NOISE, DURATION = 4, 0.2, 300  # of the sensor [s], standard deviation [K], of a run [s]


class HotPlate:
    """Heats up from ambient to target temperature once a run."""

    def __init__(self) -> None:
        self.values = dict(DEFAULTS)
        self._trace: dict[str, tuple[str, np.ndarray]] = {}

    def set_parameters(self, values: Mapping[str, float | int]) -> None:
        """Take new values, or refuse them all by ValueError."""
        for name, value in values.items():
            if name not in DEFAULTS:
                raise ValueError(f"{name}: no such parameter")
            if value < 0 or (name in ("average", "load") and value == 0):
                raise ValueError(f"{name}: {value} is too small")
        self.values.update(values)

    def evaluate(self) -> dict[str, float | str]:
        """Run once; returns how it went and the metrics."""
        v = self.values
        noise = np.random.default_rng(int(v["seed"])).normal(0.0, NOISE, DURATION)
        temperature = np.full(DURATION + 1, AMBIENT)
        power = np.zeros(DURATION)
        readings: deque[float] = deque(maxlen=int(v["average"]))
        integral = 0.0
        for k in range(DURATION):
            readings.append(temperature[max(k - DELAY, 0)] + noise[k])
            error = TARGET - sum(readings) / len(readings)
            wanted = v["kp"] * error + integral
            power[k] = min(max(wanted, 0.0), MAX_POWER)
            if wanted == power[k]:  # no integration while the power is at a limit
                integral += v["ki"] * error
            flow = power[k] - v["draught"] * LOSS * (temperature[k] - AMBIENT)
            temperature[k + 1] = temperature[k] + flow / (v["load"] * CAPACITY)
            if temperature[k + 1] > CUT_OUT:
                return {"status": "failed", "reason": f"cut out at {CUT_OUT:g} degrees in s {k}"}
        self._trace = {
            "time": ("s", np.arange(DURATION, dtype=float)),
            "temperature": ("degrees Celsius", temperature[:-1]),
            "power": ("W", power),
        }
        return {
            "status": "ok",
            "mean_error": float(np.mean(np.abs(TARGET - temperature))),
            "overshoot": max(float(np.max(temperature)) - TARGET, 0.0),
            "power_change": float(np.mean(np.abs(np.diff(power)))),
        }

    def trace(self) -> dict[str, tuple[str, np.ndarray]]:
        """Return the signals of the last run with their units, for the report."""
        return self._trace
