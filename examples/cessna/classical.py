"""Gains by the rule of Ziegler and Nichols, for the loops of bank and climb.

JSBSim linearizes the aircraft in level flight; python-control finds the gain at which each loop
just oscillates (the ultimate gain, here the gain margin), and the period of that: J. G. Ziegler and
N. B. Nichols, Optimum settings for automatic controllers, Trans. ASME 64 (1942). What the rule says
nothing of, such as the corners of the two lags, keeps the value of the package.
"""

import functools
import math
from collections.abc import Sequence

import control
import jsbsim
import numpy as np
from aircraft import PERIOD, Aircraft, Conditions

STATES = {
    "DeCmd": ("Vt", "Alpha", "Theta", "Q", "Rpm0"),
    "DaCmd": ("Beta", "Phi", "P", "R"),
}
LOOPS = ("bank", "climb")
ACTUATOR = 60.0  # corner of the elevator's [rad/s]; the aileron's is fast, but limited in its rate


# JSBSim takes some seconds for it.
@functools.cache
def linearized(conditions: Conditions) -> jsbsim.FGLinearization:
    """Return the aircraft in level flight, as a linear system."""
    return Aircraft(conditions).linearize()


def airframe(conditions: Conditions, command: str, output: str) -> control.StateSpace:
    """Return the aircraft from a command (-1 to 1) to its bank or climb.

    The output is `Phi`, the bank [rad], or `Alt`, of which the climb [ft/s] is the derivative. With
    the elevator's actuator, and a delay of one and a half periods of the autopilot.
    """
    linear = linearized(conditions)
    names = list(linear.x_names)
    rows = [names.index(name) for name in STATES[command]]
    k, u = names.index(output), linear.u_names.index(command)
    a, b = np.array(linear.system_matrix), np.array(linear.input_matrix)
    # The climb is the derivative of the state Alt.
    c, d = (a[k], b[k, u]) if output == "Alt" else (np.eye(len(a))[k], 0.0)
    model = control.ss(a[np.ix_(rows, rows)], b[np.ix_(rows, [u])], c[rows][np.newaxis], [[d]])
    if command == "DeCmd":
        model = -model * control.tf([ACTUATOR], [1.0, ACTUATOR])  # up is a negative elevator
    return model * control.tf(*control.pade(1.5 * PERIOD, 3))


def ultimate(loop: control.StateSpace) -> tuple[float, float]:
    """Return the gain at which a loop just oscillates, and the period of that [s]."""
    gain, _, crossover, _ = control.margin(loop)
    return float(gain), 2.0 * math.pi / float(crossover)


@functools.cache
def ultimates() -> tuple[tuple[float, float], tuple[float, float]]:
    """Return ultimate gain and period [s] of the bank and of the climb, in still air."""
    return (
        ultimate(airframe(Conditions(), "DaCmd", "Phi")),
        ultimate(airframe(Conditions(), "DeCmd", "Alt")),
    )


def ziegler_nichols() -> dict[str, dict[str, float]]:
    """Return the gains of the autopilot that follow from the rule, by the kind of controller."""
    (bank, bank_period), (climb, climb_period) = ultimates()
    return {
        "Ziegler-Nichols, P": detuned([1.0] * len(LOOPS)),
        "Ziegler-Nichols, PID and PI": {
            "bank_p": 0.6 * bank,
            "bank_i": 0.6 * bank / (bank_period / 2.0),
            "bank_d": 0.6 * bank * bank_period / 8.0,
            "climb_p": 0.45 * climb,
            "climb_i": 0.45 * climb / (climb_period / 1.2),
        },
    }


def detuned(factors: Sequence[float]) -> dict[str, float]:
    """Return the gains of the rule for P controllers times factors, one for each of `LOOPS`."""
    (bank, _), (climb, _) = ultimates()
    of_bank, of_climb = factors
    return {"bank_p": of_bank * 0.5 * bank, "climb_p": of_climb * 0.5 * climb}
