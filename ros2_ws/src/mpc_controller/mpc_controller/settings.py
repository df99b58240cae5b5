"""The controller's parameter table."""

from dataclasses import dataclass
from math import pi

from feed_axis_common.errors import SettingsError
from feed_axis_common.model import (
    DiscreteModel,
    check_dead_time,
    delay_augmented,
    disturbance_augmented,
    feed_axis,
    zero_order_hold,
)
from feed_axis_common.parameters import build, config_directory, load_defaults, parameter

MEASURED, CPU, MODELLED = "measured", "cpu", "modelled"
"""How a return time is obtained."""

UNDETECTABLE = 1e-6
"""A mode that decays in a sample by less than this share of itself counts as undamped, and one with
a phase per sample this close to a multiple of pi [rad] as unseen in the samples."""


@dataclass(frozen=True)
class ControllerSettings:
    """All parameters of the controller; values that break a rule are refused by `build`."""

    control_horizon: int = parameter(
        "samples", "Control horizon H_u: free input moves", lower=1, upper=200
    )
    prediction_horizon: int = parameter(
        "samples", "Prediction horizon H_p, at least the control horizon", lower=1, upper=200
    )
    lambda_mpc: float = parameter(
        "", "Exponent of the weight on input moves, R = 10^lambda_mpc", lower=-8, upper=8
    )
    lambda_kf: float = parameter(
        "", "Exponent of the process noise covariance, Q_KF = I 10^lambda_kf", lower=-12, upper=8
    )
    estimate_disturbance: bool = parameter(
        "", "Whether filter and prediction have a constant input disturbance: no offset at rest"
    )
    lambda_disturbance: float = parameter(
        "",
        "Exponent of the disturbance's process noise, 10^lambda_disturbance times that of Q_KF",
        lower=-12,
        upper=4,
    )
    gain: float = parameter("", "Nominal gain K of the axis", lower=1e-6, upper=1e6)
    damping_ratio: float = parameter("", "Nominal damping ratio D", lower=0, upper=100)
    natural_frequency: float = parameter(
        "rad/s", "Nominal natural frequency omega_0", lower=1e-3, upper=1e5
    )
    dead_time: float = parameter("s", "Nominal dead time t_d", lower=0, upper=10)
    sample_time: float = parameter("s", "Sample time T_s", lower=1e-5, upper=10)
    measurement_variance: float = parameter(
        "(m/s)^2",
        "Variance R_KF that the filter assumes for the measurement",
        lower=1e-12,
        upper=1e6,
    )
    input_lower: float = parameter(
        "m/s", "Lower limit of the commanded velocity", lower=-1e6, upper=1e6
    )
    input_upper: float = parameter(
        "m/s", "Upper limit of the commanded velocity, above the lower", lower=-1e6, upper=1e6
    )
    joint_name: str = parameter("", "Joint that the controller drives, as in joint_states")
    return_time: str = parameter(
        "",
        "How the return time of a step is obtained: by the clock, as what its thread computed "
        "(without waiting for the processor), or from its count of operations",
        choices=(MEASURED, CPU, MODELLED),
    )
    modelled_overhead: float = parameter(
        "s", "Modelled return time of a step without its operations", lower=0, upper=10
    )
    modelled_operation_time: float = parameter(
        "s", "Modelled time of one floating-point operation", lower=0, upper=1
    )

    def __post_init__(self) -> None:
        if self.prediction_horizon < self.control_horizon:
            raise SettingsError(
                f"prediction_horizon: {self.prediction_horizon} is below "
                f"control_horizon {self.control_horizon}; it must be at least as long"
            )
        if self.input_upper <= self.input_lower:
            raise SettingsError(
                f"input_upper: {self.input_upper} is not above input_lower {self.input_lower} m/s"
            )
        check_dead_time(self.dead_time, self.sample_time)
        if self.estimate_disturbance:
            self._check_detectable()

    def model(self) -> DiscreteModel:
        """Discretize the nominal axis for filter and MPC, with a disturbance if it is estimated."""
        A, B = feed_axis(self.gain, self.damping_ratio, self.natural_frequency)
        model = delay_augmented(A, B, self.sample_time, self.dead_time)
        if not self.estimate_disturbance:
            return model
        _, Gamma = zero_order_hold(A, B, self.sample_time)
        return disturbance_augmented(model, Gamma)

    def _check_detectable(self) -> None:
        """Raise `SettingsError` if samples of the velocity do not show all states in the long run.

        A mode that decays need not be seen, and the disturbance is seen by the gain, which is not
        0 (Pannocchia and Rawlings 2003). What remains are undamped modes e^(+-j omega_0 T_s): where
        omega_0 T_s is a multiple of pi they coincide, and one output shows one of the two only.
        """
        phase = self.natural_frequency * self.sample_time
        half_turns = round(phase / pi)
        damped = self.damping_ratio * phase > UNDETECTABLE
        if not damped and half_turns > 0 and abs(phase - half_turns * pi) <= UNDETECTABLE:
            raise SettingsError(
                f"estimate_disturbance: natural_frequency {self.natural_frequency} rad/s without "
                f"damping is {half_turns} pi / sample_time, so that the samples do not show all "
                "states; expected another sample_time, or a damping_ratio above 0"
            )


def default_settings() -> ControllerSettings:
    """Read the settings that ship with the package, ``config/mpc_controller.yaml``."""
    path = config_directory(__file__) / "mpc_controller.yaml"
    return build(ControllerSettings, load_defaults(path))
