"""Gains by the rule of Ziegler and Nichols, loop by loop from the inside out.

RotorPy's controller is a cascade of proportional loops: body rate, attitude, velocity, position.
For each, the rule finds the gain at which the loop, with those inside closed, just oscillates (the
ultimate gain, here the gain margin of a linear model), and takes half of it: J. G. Ziegler and
N. B. Nichols, Optimum settings for automatic controllers, Trans. ASME 64 (1942), for P control.

The model: the rotors as a first-order lag, the zero-order hold as half a period of delay, a rigid
body, small angles, no drag, no wind.
"""

from collections.abc import Sequence

import control
from flight import PERIOD
from rotorpy.vehicles import crazyflie_params

SHARE = 0.5
"""Of the ultimate gain, for a proportional controller."""
LOOPS = ("attitude", "horizontal", "vertical")
"""Pairs of a speed loop and the loop around it."""


def ultimate_gain(loop: control.TransferFunction) -> float:
    """Return the gain at which a loop just oscillates: its gain margin."""
    return float(control.margin(loop)[0])


def ziegler_nichols() -> dict[str, dict[str, float]]:
    """Return the gains of the controller node, by the name of the rule."""
    return {"Ziegler-Nichols": detuned([1.0] * len(LOOPS))}


def detuned(factors: Sequence[float]) -> dict[str, float]:
    """Return the gains of the rule with less than `SHARE` of the ultimate gains.

    Parameters
    ----------
    factors
        Of `SHARE`, one for each of `LOOPS`.
    """
    s = control.tf("s")
    delay = control.tf(*control.pade(PERIOD / 2, 3))
    rotors = delay / (crazyflie_params.quad_params["tau_m"] * s + 1)
    of_attitude, of_horizontal, of_vertical = (SHARE * factor for factor in factors)
    kd_att, kp_att, attitude = _cascade(rotors, of_attitude)
    kd_xy, kp_xy, _ = _cascade(attitude, of_horizontal)
    kd_z, kp_z, _ = _cascade(rotors, of_vertical)
    return {
        "kp_xy": kp_xy, "kd_xy": kd_xy, "kp_z": kp_z, "kd_z": kd_z, "kp_att": kp_att,
        "kd_att": kd_att,
    }  # fmt: skip


def _cascade(
    acceleration: control.TransferFunction, share: float
) -> tuple[float, float, control.TransferFunction]:
    """Close a speed loop and a position loop around it; return kd, kp and position to set-point.

    The wanted acceleration is kp (set-point - position) - kd speed.
    """
    s = control.tf("s")
    kd = share * ultimate_gain(acceleration / s)
    speed = control.feedback(kd * acceleration / s, 1)
    kp = kd * share * ultimate_gain(speed / s)
    return kd, kp, control.minreal(control.feedback(kp / kd * speed / s, 1), verbose=False)
