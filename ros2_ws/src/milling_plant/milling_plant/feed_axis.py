"""The feed axis of Eq. 1, simulated exactly."""

from collections import deque

import numpy as np

from feed_axis_common.model import Array, feed_axis, split_dead_time, zero_order_hold
from milling_plant.settings import PlantSettings


class FeedAxis:
    """Second-order axis with dead time under a held command, in a context.

    Parameters
    ----------
    settings
        Constants of the axis; its natural frequency is taken times ``stiffness_factor`` and its
        damping ratio times ``damping_factor`` (Sec. 2).
    velocity
        Velocity [m/s] on which the axis rests at the start.
    """

    def __init__(self, settings: PlantSettings, velocity: float) -> None:
        A, B = feed_axis(
            settings.gain,
            settings.damping_ratio * settings.damping_factor,
            settings.natural_frequency * settings.stiffness_factor,
        )
        d, tau = split_dead_time(settings.dead_time, settings.sample_time)
        self._older = zero_order_hold(A, B, tau)
        self._newer = zero_order_hold(A, B, settings.sample_time - tau)
        self._x: Array = np.array([velocity, 0.0])
        self._commands = deque([velocity / settings.gain] * d, maxlen=d + 1)

    @property
    def velocity(self) -> float:
        """True velocity v_k [m/s]."""
        return float(self._x[0])

    def step(self, command: float) -> None:
        """Hold `command` [m/s] for one sample time.

        The commands of d and d - 1 samples ago act meanwhile, switched tau after the sampling
        instant, with d and tau of `split_dead_time`.
        """
        self._commands.append(command)
        u_older = self._commands[0]
        u_newer = self._commands[min(1, len(self._commands) - 1)]
        for (Phi, Gamma), u in ((self._older, u_older), (self._newer, u_newer)):
            self._x = Phi @ self._x + Gamma[:, 0] * u
