"""Closed-form and scipy answers of a second-order lag with dead time."""

import numpy as np
from scipy.signal import cont2discrete, lsim


def step_response(t, damping_ratio, natural_frequency):
    """Unit step response at times t [s], zero before t = 0; D below, at or above 1."""
    D, w = damping_ratio, natural_frequency
    t = np.maximum(np.asarray(t, dtype=float), 0.0)
    if D == 1.0:
        return 1.0 - np.exp(-w * t) * (1.0 + w * t)
    if D < 1.0:
        wd = w * np.sqrt(1.0 - D**2)
        return 1.0 - np.exp(-D * w * t) * (np.cos(wd * t) + D * w / wd * np.sin(wd * t))
    slow, fast = w * (D - np.sqrt(D**2 - 1.0)), w * (D + np.sqrt(D**2 - 1.0))
    return 1.0 - (fast * np.exp(-slow * t) - slow * np.exp(-fast * t)) / (fast - slow)


def matrices(gain, damping_ratio, natural_frequency):
    """(A, B, C, D) of the lag, states velocity and rate."""
    w = natural_frequency
    return (
        np.array([[0.0, 1.0], [-w * w, -2.0 * damping_ratio * w]]),
        np.array([[0.0], [gain * w * w]]),
        np.array([[1.0, 0.0]]),
        np.array([[0.0]]),
    )


def delayed_response(system, commands, sample_time, dead_time, parts=20):
    """Outputs at the sampling instants from rest at zero, simulated on a grid `parts` times finer.

    The dead time must be a multiple of ``sample_time / parts``.
    """
    fine = sample_time / parts
    shift = round(dead_time / fine)
    assert abs(shift * fine - dead_time) < 1e-12
    u = np.concatenate((np.zeros(shift), np.repeat(commands, parts)))[: len(commands) * parts]
    # lsim takes the input at the left end of each interval; the last value only ends the grid.
    u = np.append(u, u[-1])
    _, y, _ = lsim(system, u, np.arange(u.size) * fine, interp=False)
    return y[::parts]


class DelayLine:
    """The lag behind a whole number of samples of dead time, stepped as a queue of commands."""

    def __init__(self, system, sample_time, delay, x, past):
        self.Phi, self.Gamma, *_ = cont2discrete(system, sample_time)
        self.x = np.array(x, dtype=float)
        self.queue = list(past)
        assert len(self.queue) == delay

    def step(self, command):
        """Apply a command for one sample and return the output after it."""
        self.queue.append(command)
        self.x = self.Phi @ self.x + self.Gamma[:, 0] * self.queue.pop(0)
        return self.x[0]
