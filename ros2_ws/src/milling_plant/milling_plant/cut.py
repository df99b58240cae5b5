"""One cut: the axis along its reference, sample by sample, and its metrics.

`Cut` waits for a command in each sample and does not know where it comes from, so that the node
drives it over topics and `MillingPlant` within a process, with identical results.
"""

from collections.abc import Mapping
from dataclasses import asdict
from math import isfinite, sqrt
from typing import Protocol

import numpy as np
from scipy.ndimage import maximum_filter1d

from feed_axis_common.model import Array
from feed_axis_common.parameters import build
from milling_plant.feed_axis import FeedAxis
from milling_plant.settings import PlantSettings, default_settings


def reference_velocity(settings: PlantSettings) -> Array:
    """Make v_ref (N,) [m/s] of the levels, each held for ``samples_per_level`` samples."""
    return np.repeat(np.array(settings.reference_levels), settings.samples_per_level)


def tracking_error(reference: Array, velocity: Array) -> Array:
    """Squared tracking error of cuts, the sum of (v_ref,k - v_k)^2 [(m/s)^2], Eq. 3a.

    Shape (...) for velocities (..., N).
    """
    return np.asarray(np.sum((reference - velocity) ** 2, axis=-1))


def overshoot(reference: Array, velocity: Array, window: int) -> Array:
    """Largest excess of v_k over the highest reference within `window` samples of k [m/s].

    The window keeps a late step down from counting as overshoot. Never below 0. Shape (...) for
    velocities (..., N).
    """
    excess = velocity - ceiling(reference, window)
    return np.asarray(np.maximum(np.max(excess, axis=-1), 0.0))


def ceiling(reference: Array, window: int) -> Array:
    """Highest reference (N,) within `window` samples of k, above which v_k overshoots [m/s]."""
    return np.asarray(maximum_filter1d(reference, 2 * window + 1, mode="nearest"))


def effort(commands: Array) -> float:
    """Total variation of the command of a cut, the sum of |u_k - u_(k-1)| [m/s].

    It measures how much a controller moves the drive (Skogestad 2003, Simple analytic rules for
    model reduction and PID controller tuning, J. Process Control 13).
    """
    return float(np.sum(np.abs(np.diff(commands))))


class Cut:
    """A cut in progress.

    Parameters
    ----------
    settings
        Axis, context, noise seed and reference.

    Attributes
    ----------
    reference
        v_ref (N,) [m/s].
    sample
        Index k of the sample that waits for its command; N once the cut is done.
    failure
        Why the cut failed, or an empty text.
    disturbed
        Whether it failed for what somebody else did, which says nothing of the parameters.
    """

    def __init__(self, settings: PlantSettings) -> None:
        self._settings = settings
        self.reference = reference_velocity(settings)
        self.sample = 0
        self.failure = ""
        self.disturbed = False
        n = self.reference.size
        rng = np.random.default_rng(settings.seed)
        self._noise = rng.normal(0.0, sqrt(settings.noise_variance), n)
        self._ceiling = ceiling(self.reference, settings.overshoot_window)
        self._axis = FeedAxis(settings, float(self.reference[0]))
        self._velocity = np.full(n, np.nan)
        self._velocity[0] = self._axis.velocity
        self._commands = np.full(n, np.nan)

    @property
    def done(self) -> bool:
        """Whether the cut has ended, well or not."""
        return bool(self.failure) or self.sample == self.reference.size

    @property
    def measurement(self) -> float:
        """Measured velocity of the present sample [m/s]."""
        return float(self._velocity[self.sample] + self._noise[self.sample])

    @property
    def velocity(self) -> Array:
        """True velocity (k,) [m/s] of the samples so far."""
        return self._velocity[: min(self.sample + 1, self.reference.size)]

    def apply(self, command: float) -> None:
        """Apply the command [m/s] of the present sample and step to the next.

        A command or a velocity that is not finite, or a speed above ``velocity_limit``, fails the
        cut.
        """
        if not isfinite(command):
            self.fail(f"command of sample {self.sample} is {command}")
            return
        self._commands[self.sample] = command
        self._axis.step(command)
        v = self._axis.velocity
        if not abs(v) <= self._settings.velocity_limit:
            self.fail(f"velocity after sample {self.sample} is {v} m/s; the loop diverged")
            return
        self.sample += 1
        if self.sample < self.reference.size:
            self._velocity[self.sample] = v

    def fail(self, reason: str) -> None:
        """End the cut as failed."""
        self.failure = reason

    def so_far(self) -> dict[str, float]:
        """Return the metrics of the samples so far; none of them falls as the cut goes on."""
        velocity = self.velocity
        n = velocity.size
        excess = np.max(velocity - self._ceiling[:n])
        return {
            "tracking_error": float(tracking_error(self.reference[:n], velocity)),
            "overshoot": max(float(excess), 0.0),
            "effort": effort(self._commands[: self.sample]),
        }

    def contradicted(self, sample: int, command: float) -> bool:
        """Fail the cut, also one that has ended, if a sample had another command [m/s] than this.

        Then more than one controller answers, and the cut is none's. Returns whether that is new.
        """
        if not 0 <= sample < self.sample or self.disturbed or command == self._commands[sample]:
            return False
        both = f"{self._commands[sample]:.6g} and {command:.6g} m/s"
        self.fail(f"sample {sample} has two commands, {both}; does a second controller run?")
        self.disturbed = True
        return True

    def result(self) -> dict[str, float | str]:
        """Sum up the cut.

        Returns
        -------
        dict
            ``status`` (``ok``, ``failed`` or ``disturbed``), ``reason``, context, seed and number
            of samples, and for a whole cut ``tracking_error`` [(m/s)^2] and ``overshoot`` [m/s],
            both on the true velocity, and ``effort`` [m/s].
        """
        s = self._settings
        failed = "disturbed" if self.disturbed else "failed"
        summary: dict[str, float | str] = {
            "status": failed if self.failure else "ok",
            "reason": self.failure,
            "stiffness_factor": s.stiffness_factor,
            "damping_factor": s.damping_factor,
            "seed": s.seed,
            "samples": self.sample,
        }
        if self.done and not self.failure:
            summary["tracking_error"] = float(tracking_error(self.reference, self._velocity))
            excess = overshoot(self.reference, self._velocity, s.overshoot_window)
            summary["overshoot"] = float(excess)
            summary["effort"] = effort(self._commands)
        return summary


class Step(Protocol):
    """What a controller returns for a sample."""

    @property
    def command(self) -> float:
        """Commanded velocity [m/s]."""


class Controller(Protocol):
    """What `MillingPlant` asks of a controller in the same process."""

    def start(self, reference: Array) -> None:
        """Begin a cut along `reference` (N,) [m/s]."""

    def step(self, measurement: float) -> Step:
        """Take the measured velocity of the next sample [m/s] and give its command."""


class MillingPlant:
    """The plant node without ROS: the same parameters, cut by cut, against a controller object.

    Parameters
    ----------
    settings
        Settings of the first cut; the package's defaults if not given.
    """

    def __init__(self, settings: PlantSettings | None = None) -> None:
        self.settings = default_settings() if settings is None else settings
        self.velocity: Array = np.empty(0)
        self._trace: dict[str, tuple[str, Array]] = {}
        self._beyond: dict[str, float] = {}

    def end_beyond(self, values: Mapping[str, float]) -> None:
        """End the cuts to come as soon as one of their metrics is beyond its value.

        Parameters
        ----------
        values
            By the names of ``tracking_error``, ``overshoot`` and ``effort``, in their units.
        """
        self._beyond = dict(values)

    def set_parameters(self, values: Mapping[str, object]) -> None:
        """Change some parameters for the cuts to come, all of them or none.

        Raises
        ------
        SettingsError
            If the resulting set breaks a rule; the settings in force stay.
        """
        self.settings = build(PlantSettings, asdict(self.settings) | dict(values))

    def run_cut(self, controller: Controller) -> dict[str, float | str]:
        """Run one cut in lock-step with `controller` and return `Cut.result`."""
        cut = Cut(self.settings)
        controller.start(cut.reference)
        commands = []
        while not cut.done:
            commands.append(controller.step(cut.measurement).command)
            cut.apply(commands[-1])
            if self._is_decided(cut):
                break
        self.velocity = cut.velocity
        self._trace = self._signals(cut, np.array(commands))
        if cut.done:
            return cut.result()
        after = self.settings.sample_time * cut.sample
        return {**cut.result(), "status": "cut short", "after": after, **cut.so_far()}

    def _is_decided(self, cut: Cut) -> bool:
        """Return whether a cut that goes on is beyond a value of `end_beyond`."""
        if not self._beyond or cut.done:
            return False
        so_far = cut.so_far()
        return any(so_far[name] > most for name, most in self._beyond.items())

    def evaluate(self, controller: Controller) -> dict[str, float | str]:
        """Run one cut, under the name that the in-process backend of the tuner calls."""
        return self.run_cut(controller)

    def trace(self) -> dict[str, tuple[str, Array]]:
        """Return the signals of the last cut; empty before the first one.

        Returns
        -------
        dict from str to (str, ndarray)
            By name, each with its unit and its values (n,), of the n samples that were run.
            ``time`` is that of the others; what stands before a slash is what they have in common.
            At ``velocity/overshoot = 0`` the overshoot begins.
        """
        return dict(self._trace)

    def _signals(self, cut: Cut, commands: Array) -> dict[str, tuple[str, Array]]:
        n = commands.size
        reference, velocity = cut.reference[:n], cut.velocity[:n]
        return {
            "time": ("s", self.settings.sample_time * np.arange(n, dtype=np.float64)),
            "velocity/reference": ("m/s", reference),
            "velocity/actual": ("m/s", velocity),
            "velocity/overshoot = 0": (
                "m/s",
                ceiling(cut.reference, self.settings.overshoot_window)[:n],
            ),
            "velocity error": ("m/s", reference - velocity),
            "position error": ("m", self.settings.sample_time * np.cumsum(reference - velocity)),
            "command": ("m/s", commands),
        }
