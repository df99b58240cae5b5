"""The plant's parameter table."""

from dataclasses import dataclass

from feed_axis_common.errors import SettingsError
from feed_axis_common.model import check_dead_time
from feed_axis_common.parameters import build, config_directory, load_defaults, parameter


@dataclass(frozen=True)
class PlantSettings:
    """All parameters of the plant; values that break a rule are refused by `build`."""

    gain: float = parameter("", "Gain K of the axis", lower=1e-6, upper=1e6)
    damping_ratio: float = parameter("", "Nominal damping ratio D", lower=0, upper=100)
    natural_frequency: float = parameter(
        "rad/s", "Nominal natural frequency omega_0", lower=1e-3, upper=1e5
    )
    dead_time: float = parameter("s", "Dead time t_d of the command", lower=0, upper=10)
    sample_time: float = parameter("s", "Sample time T_s", lower=1e-5, upper=10)
    stiffness_factor: float = parameter(
        "", "Context: factor on the natural frequency", lower=0.01, upper=100
    )
    damping_factor: float = parameter(
        "", "Context: factor on the damping ratio", lower=0.01, upper=100
    )
    noise_variance: float = parameter(
        "(m/s)^2", "Variance of the Gaussian measurement noise", lower=0, upper=1e6
    )
    seed: int = parameter("", "Seed of a cut's measurement noise", lower=0, upper=2**63 - 1)
    reference_levels: tuple[float, ...] = parameter(
        "m/s", "Levels of the reference velocity, one after the other", lower=-1e6, upper=1e6
    )
    samples_per_level: int = parameter(
        "samples", "Length of each reference level", lower=1, upper=100_000
    )
    overshoot_window: int = parameter(
        "samples",
        "Overshoot counts above the highest reference this far before and after a sample",
        lower=0,
        upper=100_000,
    )
    velocity_limit: float = parameter(
        "m/s", "A cut in which the speed exceeds this has diverged and fails", lower=0, upper=1e9
    )
    joint_name: str = parameter("", "Name of the axis in joint_states")
    command_timeout: float = parameter(
        "s",
        "A cut whose next command does not come within this wall time fails",
        lower=0.01,
        upper=600,
    )
    resend_period: float = parameter(
        "s",
        "A measurement without an answer is sent again after this wall time",
        lower=0.005,
        upper=60,
    )

    def __post_init__(self) -> None:
        samples = len(self.reference_levels) * self.samples_per_level
        if samples > 1_000_000:
            raise SettingsError(
                f"samples_per_level: a cut of {samples} samples; expected at most 1000000"
            )
        check_dead_time(self.dead_time, self.sample_time)


def default_settings() -> PlantSettings:
    """Read the settings that ship with the package, ``config/milling_plant.yaml``."""
    return build(PlantSettings, load_defaults(config_directory(__file__) / "milling_plant.yaml"))
