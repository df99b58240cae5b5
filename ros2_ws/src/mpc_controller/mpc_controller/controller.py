"""One controller step, cut by cut: estimate, optimize, predict.

`MpcController` knows nothing of ROS. The node feeds it from topics; the in-process backend of the
tuner calls it directly. Equal settings and measurements give equal commands, bit for bit.
"""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from math import isfinite
from time import perf_counter, thread_time

import numpy as np

from feed_axis_common.model import Array
from feed_axis_common.parameters import build
from mpc_controller.errors import ControllerError
from mpc_controller.kalman_filter import kalman_filter
from mpc_controller.mpc import Mpc, Solution
from mpc_controller.qp import condense
from mpc_controller.return_time import (
    filter_operations,
    iteration_operations,
    program_operations,
    quantiles,
)
from mpc_controller.settings import CPU, MODELLED, ControllerSettings, default_settings

HOLD_LAST_INPUT = "hold_last_input"
"""The fallback of a step without a usable solution: the last command is given again."""
FASTEST = 1e9
"""Speed [m/s] from which on a measurement is none: some drives mark one by the largest number."""


@dataclass(frozen=True)
class Step:
    """Result of one sample.

    Attributes
    ----------
    command
        Commanded velocity u_k [m/s].
    estimate
        Velocity estimate after the measurement [m/s].
    return_time
        Time from the measurement to the command [s], as the settings have it.
    status
        ``solved``, or why the fallback was taken.
    """

    command: float
    estimate: float
    return_time: float
    status: str


class MpcController:
    """Kalman filter and MPC with settings that change between cuts.

    Parameters
    ----------
    settings
        Settings of the first cut; the package's defaults if not given.
    """

    def __init__(self, settings: ControllerSettings | None = None) -> None:
        self.settings = default_settings() if settings is None else settings
        self._reference: Array | None = None
        self._clock = perf_counter

    def set_parameters(self, values: Mapping[str, object]) -> None:
        """Change some parameters for the cuts to come, all of them or none.

        Raises
        ------
        SettingsError
            If the resulting set breaks a rule; the settings in force stay.
        """
        self.settings = build(ControllerSettings, asdict(self.settings) | dict(values))

    def start(self, reference: Sequence[float] | Array) -> None:
        """Begin a cut along `reference` (N,) [m/s], at rest on its first value.

        Raises
        ------
        ControllerError
            If the reference is empty or not finite.
        """
        self._reference = None
        r = np.asarray(reference, dtype=float)
        if r.ndim != 1 or r.size == 0 or not np.isfinite(r).all():
            raise ControllerError(
                f"reference: expected at least one finite velocity [m/s], found shape {r.shape}"
            )
        s = self.settings
        self._in_force = s
        # OSQP solves in the calling thread: its computing time is that of this one.
        self._clock = thread_time if s.return_time == CPU else perf_counter
        model = s.model()
        program = condense(model, s.control_horizon, s.prediction_horizon, s.lambda_mpc)
        self._mpc = Mpc(program, s.input_lower, s.input_upper)
        self._kf = kalman_filter(
            model,
            s.measurement_variance,
            s.lambda_kf,
            model.equilibrium(r[0], s.gain),
            s.lambda_disturbance,
        )
        n = model.A.shape[0]
        self._fixed_operations = filter_operations(n) + program_operations(
            n, s.control_horizon, s.prediction_horizon
        )
        self._reference = r
        # Past its end the reference stays on its last value.
        self._preview = np.concatenate((r, np.full(s.prediction_horizon, r[-1])))
        self._last_input = min(max(float(r[0]) / s.gain, s.input_lower), s.input_upper)
        self._samples = 0
        self._return_times: list[float] = []
        self._iterations = 0
        self._faults: list[str] = []

    @property
    def reference_length(self) -> int:
        """Number of samples N of the present cut; 0 before the first."""
        return 0 if self._reference is None else self._reference.size

    @property
    def samples_done(self) -> int:
        """Number of samples of the present cut that have their command."""
        return self._samples if self._reference is not None else 0

    def skip(self) -> None:
        """Bridge the next sample by the model: its measurement was lost, and no command was given.

        The drive still has the last one. The sample is counted as a fallback in `cut_result`.

        Raises
        ------
        ControllerError
            If no cut was started or all samples of the cut are done.
        """
        k = self._expect_sample("skip")
        self._faults.append(f"sample {k}: the measurement was lost")
        self._kf.predict(self._last_input)
        self._samples += 1

    def step(self, measurement: float) -> Step:
        """Take the measured velocity of the next sample [m/s] and give its command.

        A measurement that is not finite, or is at least `FASTEST`, is left out of the estimate; a
        program without a usable solution falls back on `HOLD_LAST_INPUT`. Both are counted in
        `cut_result`.

        Raises
        ------
        ControllerError
            If no cut was started or all samples of the cut are done.
        """
        begin = self._clock()
        k = self._expect_sample("step")
        s = self._in_force
        if isfinite(measurement) and abs(measurement) < FASTEST:
            self._kf.update(measurement)
        else:
            self._faults.append(f"sample {k}: measurement is {measurement}")
        x = self._kf.x[:, 0]
        estimate = float(x[0])
        solution = self._mpc.solve(
            x, self._last_input, self._preview[k + 1 : k + 1 + s.prediction_horizon]
        )
        if solution.input is None:
            self._faults.append(f"sample {k}: solver status {solution.status}; {HOLD_LAST_INPUT}")
        else:
            self._last_input = solution.input
        self._kf.predict(self._last_input)
        self._samples += 1
        self._iterations += solution.iterations
        elapsed = self._clock() - begin
        self._return_times.append(
            self._modelled_return_time(solution) if s.return_time == MODELLED else elapsed
        )
        return Step(self._last_input, estimate, self._return_times[-1], solution.status)

    def result(self) -> dict[str, float | str]:
        """Return `cut_result`, under the name that the in-process backend of the tuner calls."""
        return self.cut_result()

    def cut_result(self) -> dict[str, float | str]:
        """Sum up the present cut.

        Returns
        -------
        dict
            ``status`` (``ok`` or ``failed``), ``reason``, the number of ``fallbacks``, quantiles
            of the return time [s] and how it was obtained, mean iterations per sample, and the
            parameters under which the cut ran.
        """
        s = self._in_force
        return {
            "status": "failed" if self._faults else "ok",
            "reason": self._faults[0] if self._faults else "",
            "fallbacks": len(self._faults),
            "samples": self.samples_done,
            "return_time_source": s.return_time,
            **(quantiles(self._return_times) if self._return_times else {}),
            "mean_iterations": self._iterations / max(len(self._return_times), 1),
            "control_horizon": s.control_horizon,
            "prediction_horizon": s.prediction_horizon,
            "lambda_mpc": s.lambda_mpc,
            "lambda_kf": s.lambda_kf,
            **({"lambda_disturbance": s.lambda_disturbance} if s.estimate_disturbance else {}),
        }

    def _expect_sample(self, name: str) -> int:
        """Return the index of the next sample."""
        if self._reference is None or self._samples >= self._reference.size:
            raise ControllerError(f"{name}: no cut is running; call start with a reference first")
        return self._samples

    def _modelled_return_time(self, solution: Solution) -> float:
        s = self._in_force
        operations = self._fixed_operations
        operations += solution.iterations * iteration_operations(s.control_horizon)
        return s.modelled_overhead + operations * s.modelled_operation_time
