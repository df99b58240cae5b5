"""The parameters that are best on the mean of some bags, found without ROS and the tuner.

python optimum.py axis cuts/trial_*
python optimum.py attitude flights/*
"""

import sys
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from statistics import mean

import attitude
import axis
import numpy as np
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore
from scipy.optimize import minimize

TYPES = get_typestore(Stores.ROS2_JAZZY)


Heard = tuple[str, int, float]
"""A message of the axis: topic, stamp [ns], and velocity [m/s], of a reference the first one."""


def messages(bag: Path) -> Iterator[Heard]:
    """Yield what the filter of the axis hears of a bag."""
    with AnyReader([bag], default_typestore=TYPES) as reader:
        topics = (axis.REFERENCE, axis.MEASURED, axis.COMMAND)
        own = [c for c in reader.connections if c.topic in topics]
        for connection, _, data in reader.messages(own):
            message = reader.deserialize(data, connection.msgtype)
            of_reference = connection.topic == axis.REFERENCE
            values = message.points[0].velocities if of_reference else message.velocity
            stamp = message.header.stamp
            yield connection.topic, stamp.sec * 1_000_000_000 + stamp.nanosec, float(values[0])


def surprise(heard: list[Heard], filter_: axis.Filter) -> float:
    """Return the mean of log s + nu^2 / s over all measurements of a bag.

    It is twice the negative logarithm of the likelihood of the innovations nu with variances s, but
    for a constant (A. C. Harvey, Forecasting, Structural Time Series Models and the Kalman Filter,
    Cambridge 1989, section 3.4).
    """
    found = [result for message in heard if (result := filter_.take(*message))]
    return float(np.mean([np.log(s) + nu**2 / s for _, nu, s in found]))


def tilt_error(made: attitude.Flight, filter_: attitude.Filter) -> float:
    """Return the root of the mean square of the error of roll and pitch [rad] at the messages."""
    squares = []
    for time, rate, felt in made.measured:
        found = attitude.roll_pitch(filter_.take(time, rate, felt))
        true = attitude.roll_pitch(made.truth[round(time * attitude.RATE)])
        squares.append(sum((f - t) ** 2 for f, t in zip(found, true, strict=True)))
    return float(np.sqrt(np.mean(squares)))


Cost = Callable[[Sequence[float]], float]


def best(cost: Cost, start: Sequence[float]) -> tuple[list[float], float]:
    """Return the logarithms at which a cost is least, and the cost."""
    found = minimize(cost, start, method="Nelder-Mead", options={"maxfev": 200})
    return found.x.tolist(), float(found.fun)


def main(what: str, *words: str) -> None:
    """Find them, and print them; or the mean at values that are given by name."""
    given = dict(word.split("=") for word in words if "=" in word)
    bags = [word for word in words if "=" not in word]
    if what == "axis":
        heard = [list(messages(Path(bag))) for bag in bags]

        def mean_surprise(exponents: Sequence[float]) -> float:
            noise = exponents[0], 10.0 ** exponents[1]
            return mean(surprise(each, axis.Filter(*noise)) for each in heard)

        cost, start, names = mean_surprise, [-3.0, -3.0], ("lambda_kf", "measurement_variance")
        to_values, to_exponents = lambda x: (x[0], 10.0 ** x[1]), lambda v: (v[0], np.log10(v[1]))
    else:
        flights = [attitude.flight(int(bag.rpartition("_")[2])) for bag in bags]

        def mean_error(exponents: Sequence[float]) -> float:
            return mean(tilt_error(each, attitude.Filter(*np.exp(exponents))) for each in flights)

        cost, start, names = mean_error, np.log([1.0, 0.1, 0.3]), ("gain", "bias_gain", "trust")
        to_values, to_exponents = np.exp, np.log
    if given:
        print(f"mean {cost(to_exponents([float(given[name]) for name in names])):.4g}")
        return
    exponents, least = best(cost, start)
    values = zip(names, to_values(exponents), strict=True)
    print(f"{', '.join(f'{name} {value:.3g}' for name, value in values)}: mean {least:.4g}")


if __name__ == "__main__":
    main(*sys.argv[1:])
