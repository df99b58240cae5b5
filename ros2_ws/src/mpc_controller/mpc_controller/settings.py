"""The controller's parameter table."""

from dataclasses import dataclass

from feed_axis_common.errors import SettingsError
from feed_axis_common.model import check_dead_time
from feed_axis_common.parameters import build, config_directory, load_defaults, parameter


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
        "How the return time of a step is obtained: by the clock, or from its count of operations",
        choices=("measured", "modelled"),
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


def default_settings() -> ControllerSettings:
    """Read the settings that ship with the package, ``config/mpc_controller.yaml``."""
    path = config_directory(__file__) / "mpc_controller.yaml"
    return build(ControllerSettings, load_defaults(path))
