"""Shows what each gain does alone: each is made smaller and larger, in four conditions.

Prints a table in Markdown: 52 flights, each 0.8 s of a processor or more.
"""

import math
from concurrent.futures import ProcessPoolExecutor

import numpy as np
from judge import DEFAULT, Conditions, judge_all

FACTORS = (0.6, 1.5)
SLOW, FAST = 0.09, 0.05
CONDITIONS = (
    Conditions(seed=1),
    Conditions(wind_speed=3.0, payload=0.006, motor_time_constant=SLOW, seed=2),
    Conditions(
        wind_speed=3.0, wind_direction=math.pi, payload=0.003, motor_time_constant=FAST, seed=3
    ),
    Conditions(wind_speed=1.5, wind_direction=math.pi / 2, payload=0.006, seed=4),
)


def main() -> None:
    """Fly and print."""
    sets = {"default": dict(DEFAULT)}
    sets |= {
        f"{name} × {factor:g}": dict(DEFAULT) | {name: factor * value}
        for name, value in DEFAULT.items()
        for factor in FACTORS
    }
    print("| gains | mean error [m] | largest overshoot [%] | mean effort [rad/s] | crashes |")
    print("|---|---|---|---|---|")
    with ProcessPoolExecutor() as executor:
        for name, gains in sets.items():
            flights = judge_all(gains, CONDITIONS, executor)
            error = np.mean([flight.error for flight in flights])
            overshoot = max(flight.overshoot for flight in flights)
            effort = np.mean([flight.effort for flight in flights])
            crashes = sum(flight.crashed for flight in flights)
            print(f"| {name} | {error:.3f} | {overshoot:.1f} | {effort:.0f} | {crashes} |")


if __name__ == "__main__":
    main()
