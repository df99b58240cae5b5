"""The Kalman filter of the shipped feed axis, on bags that its trials have recorded.

python axis.py cuts/*        the variances that are best on the worst of these bags
"""

from mpc_controller.kalman_filter import kalman_filter
from mpc_controller.settings import default_settings

REFERENCE, MEASURED, COMMAND = (
    "/mpc_controller/joint_trajectory",
    "/joint_states",
    "/mpc_controller/command",
)

Result = tuple[float, float, float]
"""The estimate [m/s], the innovation [m/s], and its variance."""


class Filter:
    """The filter of the controller, which begins anew with each cut.

    Parameters
    ----------
    lambda_kf
        Exponent of the process noise covariance.
    measurement_variance
        Variance of the measurement [(m/s)^2].
    """

    def __init__(self, lambda_kf: float, measurement_variance: float) -> None:
        self.settings = default_settings()
        self.noise = measurement_variance, lambda_kf
        self.commands: dict[int, float] = {}
        self.latest: tuple[int, float] | None = None
        self.begin(0, 0.0)

    def take(self, topic: str, time: int, velocity: float) -> Result | None:
        """Take a message with a stamp [ns]; returns what a measurement has shown.

        A stamp is the number of a sample, and of one sample the messages may come in any order.
        """
        if topic == REFERENCE:
            return self.begin(time, velocity)
        if topic == COMMAND:
            self.commands[time] = velocity
            return None
        return self.update(time, velocity)

    def begin(self, time: int, velocity: float) -> Result | None:
        """Begin a cut at rest on a velocity [m/s]; its first measurement may have come before."""
        model = self.settings.model()
        start = model.equilibrium(velocity, self.settings.gain)
        self.kalman = kalman_filter(model, *self.noise, start)
        self.commands = {when: value for when, value in self.commands.items() if when >= time}
        early = self.latest
        return self.update(*early) if early is not None and early[0] == time else None

    def update(self, time: int, velocity: float) -> Result:
        """Go on by the commands of the samples before, and take a measurement [m/s]."""
        for when in sorted(when for when in self.commands if when < time):
            self.kalman.predict(self.commands.pop(when))
        self.latest = time, velocity
        self.kalman.update(velocity)
        return float(self.kalman.x[0, 0]), float(self.kalman.y[0, 0]), float(self.kalman.S[0, 0])
