"""A two-wheeled robot outdoors: drives with the noise that real sensors have, and its filter.

The filter is an extended Kalman filter of the position, the heading and the bias of the gyroscope,
after S. Thrun, W. Burgard and D. Fox, Probabilistic Robotics, MIT Press 2005, section 3.3.
"""

import math
from dataclasses import dataclass, field

import numpy as np

RATE = 50.0
"""Messages of the gyroscope in a second; of the wheels half as many, of the position a tenth."""
SPEED_NOISE, SLIP, SLIPPING = 0.05, 0.25, 0.05
"""Noise of the speed of the wheels [m/s], share by which they slip, and how often [1/s]."""
GYRO_NOISE, BIAS_WALK = 0.01, 0.003
"""Noise of the yaw rate [rad/s], and walk of its bias [rad/s per root of a second]."""
FIX_NOISE, OUTAGE = 0.4, 0.03
"""Noise of the position [m], and how often its receiver has an outage of 2 to 6 s [1/s]."""


@dataclass
class Drive:
    """A drive: the truth (n, 3) of x, y [m] and yaw [rad] at times (n,) [s], and what was sensed.

    `wheels`, `gyro` and `fixes` are lists of times [s] with a speed [m/s], a yaw rate [rad/s] and a
    position [m].
    """

    times: np.ndarray
    truth: np.ndarray
    wheels: list[tuple[float, float]] = field(default_factory=list)
    gyro: list[tuple[float, float]] = field(default_factory=list)
    fixes: list[tuple[float, float, float]] = field(default_factory=list)


def drive(seed: int, seconds: float = 60.0) -> Drive:
    """Make a drive; the same one for the same seed."""
    rng = np.random.default_rng(seed)
    times = np.arange(round(seconds * RATE)) / RATE
    waves = rng.uniform([0.02, 0.0], [0.2, 2 * math.pi], (4, 2))
    speed = 1.0 + 0.25 * sum(np.sin(2 * math.pi * f * times + phase) for f, phase in waves[:2])
    turn = 0.4 * sum(np.sin(2 * math.pi * f * times + phase) for f, phase in waves[2:])
    yaw = np.cumsum(turn) / RATE
    truth = np.column_stack([np.cumsum(speed * np.cos(yaw)), np.cumsum(speed * np.sin(yaw))]) / RATE
    made = Drive(times, np.column_stack([truth, yaw]))
    bias = rng.normal(0.0, 0.01) + np.cumsum(
        rng.normal(0.0, BIAS_WALK / math.sqrt(RATE), len(times))
    )
    slips_until = lost_until = -1.0
    for k, time in enumerate(times):
        made.gyro.append((time, float(turn[k] + bias[k] + rng.normal(0.0, GYRO_NOISE))))
        if k % 2 == 0:
            if rng.random() < SLIPPING * 2 / RATE:
                slips_until = time + rng.uniform(0.5, 2.0)
            slip = 1.0 + SLIP * (time < slips_until)
            made.wheels.append((time, float(speed[k] * slip + rng.normal(0.0, SPEED_NOISE))))
        if k % 10 == 0:
            if rng.random() < OUTAGE * 10 / RATE:
                lost_until = time + rng.uniform(2.0, 6.0)
            x, y = truth[k] + rng.normal(0.0, FIX_NOISE, 2)
            if time >= lost_until:
                made.fixes.append((time, float(x), float(y)))
    return made


class Filter:
    """The filter, with the noise that it expects.

    Parameters
    ----------
    speed_noise
        Of the speed, slips included [m/s per root of a second].
    bias_walk
        Of the gyroscope [rad/s per root of a second].
    fix_noise
        Of a position [m].
    """

    def __init__(self, speed_noise: float, bias_walk: float, fix_noise: float) -> None:
        self.process = np.array([speed_noise, GYRO_NOISE, bias_walk]) ** 2
        self.measurement = np.eye(2) * fix_noise**2
        self.state = np.zeros(4)
        self.covariance = np.diag([1.0, 1.0, 0.1, 0.01]) ** 2
        self.speed = 0.0
        self.time: float | None = None

    def predict(self, time: float, yaw_rate: float) -> None:
        """Go on to the time [s] of a yaw rate [rad/s], with the latest speed."""
        step = 0.0 if self.time is None else time - self.time
        self.time = time
        x, y, yaw, bias = self.state
        cos, sin, way = math.cos(yaw), math.sin(yaw), self.speed * step
        self.state = np.array([x + way * cos, y + way * sin, yaw + step * (yaw_rate - bias), bias])
        slope = np.eye(4)
        slope[0, 2], slope[1, 2], slope[2, 3] = -way * sin, way * cos, -step
        gain = np.array([[cos, 0, 0], [sin, 0, 0], [0, 1, 0], [0, 0, 1]], dtype=float)
        noise = gain @ np.diag(self.process * step) @ gain.T
        self.covariance = slope @ self.covariance @ slope.T + noise

    def correct(self, x: float, y: float) -> None:
        """Take a position [m] into account."""
        pht = self.covariance[:, :2]
        gain = pht @ np.linalg.inv(self.covariance[:2, :2] + self.measurement)
        self.state = self.state + gain @ (np.array([x, y]) - self.state[:2])
        self.covariance = self.covariance - gain @ pht.T
        self.covariance = 0.5 * (self.covariance + self.covariance.T)


def estimates(made: Drive, filter_: Filter) -> np.ndarray:
    """Return what a filter makes of a drive: at times (n,) x, y [m] and yaw [rad], (n, 4)."""
    events = [(time, 0, (speed,)) for time, speed in made.wheels]
    events += [(time, 1, position) for time, *position in made.fixes]
    events += [(time, 2, (rate,)) for time, rate in made.gyro]
    rows = []
    for time, kind, values in sorted(events, key=lambda event: event[:2]):
        if kind == 0:
            (filter_.speed,) = values
        elif kind == 1:
            filter_.correct(*values)
        else:
            filter_.predict(time, *values)
            rows.append([time, *filter_.state[:3]])
    return np.array(rows)
