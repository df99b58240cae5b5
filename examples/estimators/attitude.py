"""A vehicle that turns in the air: flights with the noise of a cheap inertial unit, and its filter.

The filter is the explicit complementary one of R. Mahony, T. Hamel and J.-M. Pflimlin, IEEE TAC 53
(2008) 1203-1218, section V, with gravity as its only direction: roll and pitch, but not the
heading.
"""

import math
from dataclasses import dataclass, field

import numpy as np

RATE = 50.0
"""Messages of the inertial unit in a second."""
GRAVITY = 9.81
GYRO_NOISE, BIAS, BIAS_WALK = 0.02, 0.03, 0.003
"""Noise of a yaw rate [rad/s]; of its bias the first value, and the walk [rad/s per root of s]."""
ACCELERATION_NOISE = 0.15
"""Of a measured acceleration [m/s^2]."""
PUSHED, PUSH = 0.15, (1.0, 4.0)
"""How often the vehicle accelerates for 0.5 to 3 s [1/s], and by how much [m/s^2]."""
LOST = 0.05
"""How often messages are lost, for 0.1 to 0.8 s [1/s]."""

Vector = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]
"""Of a rotation from the body to the world, as w, x, y, z."""


@dataclass
class Flight:
    """A flight: the true rotations at times (n,) [s], and what was measured.

    `measured` are times [s] with a turn rate [rad/s] and an acceleration [m/s^2], of the body.
    """

    times: np.ndarray
    truth: list[Quaternion] = field(default_factory=list)
    measured: list[tuple[float, Vector, Vector]] = field(default_factory=list)


def product(a: Quaternion, b: Quaternion) -> Quaternion:
    """Multiply two quaternions."""
    return (
        a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3],
        a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2],
        a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1],
        a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0],
    )


def turned(rotation: Quaternion, rate: Vector, step: float) -> Quaternion:
    """Turn a body for a time [s] at a rate [rad/s]."""
    angle = step * math.hypot(*rate)
    share = 0.5 * step if angle < 1e-12 else step * math.sin(0.5 * angle) / angle
    made = product(rotation, (math.cos(0.5 * angle), *(share * item for item in rate)))
    length = math.hypot(*made)
    return tuple(item / length for item in made)


def in_body(rotation: Quaternion, vector: Vector) -> Vector:
    """Return a vector of the world as the body sees it."""
    w, x, y, z = rotation
    return product(product((w, -x, -y, -z), (0.0, *vector)), rotation)[1:]


def rotation_of(roll: float, pitch: float, yaw: float) -> Quaternion:
    """Return the rotation by angles [rad] about the fixed axes x, y and z, in this order."""
    x, y, z = ((math.cos(0.5 * a), math.sin(0.5 * a)) for a in (roll, pitch, yaw))
    about_z = (z[0], 0.0, 0.0, z[1])
    return product(product(about_z, (y[0], 0.0, y[1], 0.0)), (x[0], x[1], 0.0, 0.0))


def rate_between(rotation: Quaternion, following: Quaternion) -> Vector:
    """Return the turn rate [rad/s] of a body from one message to the next."""
    w, x, y, z = rotation
    cos, *axis = product((w, -x, -y, -z), following)
    sin = math.hypot(*axis)
    share = 2.0 * RATE if sin < 1e-12 else 2.0 * RATE * math.atan2(sin, cos) / sin
    return tuple(share * item for item in axis)


def roll_pitch(rotation: Quaternion) -> tuple[float, float]:
    """Return the angles [rad] about the x and the y axis."""
    w, x, y, z = rotation
    sine = max(-1.0, min(1.0, 2.0 * (w * y - z * x)))
    return math.atan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y)), math.asin(sine)


def flight(seed: int, seconds: float = 60.0) -> Flight:
    """Make a flight; the same one for the same seed."""
    rng = np.random.default_rng(seed)
    times = np.arange(round(seconds * RATE)) / RATE
    made = Flight(times)
    waves = rng.uniform([0.03, 0.0], [0.3, 2 * math.pi], (3, 2, 2))
    # It begins level.
    angles = np.minimum(0.1 * times, 0.3) * np.array(
        [sum(np.sin(2 * math.pi * f * times + phase) for f, phase in axis) for axis in waves]
    )
    made.truth = [rotation_of(*column) for column in angles.T.tolist()]
    following = made.truth[1:] + made.truth[-1:]
    rates = np.array([rate_between(*pair) for pair in zip(made.truth, following, strict=True)]).T
    walk = rng.normal(0.0, BIAS_WALK / math.sqrt(RATE), (3, len(times))).cumsum(axis=1)
    bias = rng.normal(0.0, BIAS, (3, 1)) + walk
    gyro = (rates + bias + rng.normal(0.0, GYRO_NOISE, rates.shape)).T
    noise = rng.normal(0.0, ACCELERATION_NOISE, (len(times), 3))
    push, pushed_until, lost_until = (0.0, 0.0), -1.0, -1.0
    for k, time in enumerate(times):
        if rng.random() < PUSHED / RATE:
            pushed_until = time + rng.uniform(0.5, 3.0)
            size, angle = rng.uniform(*PUSH), rng.uniform(0.0, 2 * math.pi)
            push = (size * math.cos(angle), size * math.sin(angle))
        if rng.random() < LOST / RATE:
            lost_until = time + rng.uniform(0.1, 0.8)
        if time >= lost_until:
            force = (*push, GRAVITY) if time < pushed_until else (0.0, 0.0, GRAVITY)
            felt = np.array(in_body(made.truth[k], force)) + noise[k]
            made.measured.append((float(time), tuple(gyro[k].tolist()), tuple(felt.tolist())))
    return made


class Filter:
    """The filter.

    Parameters
    ----------
    gain
        How fast the rotation follows gravity [1/s].
    bias_gain
        How fast the bias does [1/s^2].
    trust
        How far a measured acceleration may be from gravity in size, so that it is used [m/s^2].
    """

    def __init__(self, gain: float, bias_gain: float, trust: float) -> None:
        self.gain, self.bias_gain, self.trust = gain, bias_gain, trust
        self.rotation: Quaternion = (1.0, 0.0, 0.0, 0.0)
        self.bias = [0.0, 0.0, 0.0]
        self.time: float | None = None

    def take(self, time: float, rate: Vector, felt: Vector) -> Quaternion:
        """Go on to the time [s] of a turn rate [rad/s] and an acceleration [m/s^2]."""
        step = 0.0 if self.time is None else time - self.time
        self.time = time
        size = math.hypot(*felt)
        error = (0.0, 0.0, 0.0)
        if size > 0.0 and abs(size - GRAVITY) <= self.trust:
            x, y, z = (item / size for item in felt)
            u, v, w = in_body(self.rotation, (0.0, 0.0, 1.0))
            error = (y * w - z * v, z * u - x * w, x * v - y * u)
        corrected = tuple(
            r - b + self.gain * e for r, b, e in zip(rate, self.bias, error, strict=True)
        )
        self.rotation = turned(self.rotation, corrected, step)
        self.bias = [b - step * self.bias_gain * e for b, e in zip(self.bias, error, strict=True)]
        return self.rotation
