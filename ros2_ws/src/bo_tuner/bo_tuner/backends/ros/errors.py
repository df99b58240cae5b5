"""Why an evaluation on ROS nodes does not count."""


class LostError(Exception):
    """A node died, or is not there."""


class SilentError(LostError):
    """A node does not answer in time."""


class RefusedError(Exception):
    """A node refused its parameters, or did not take their values."""


class UnpreparedError(Exception):
    """The steps before a run failed with the safe parameters: the run did not begin."""


class DisturbedError(Exception):
    """Somebody else has a hand in the evaluation, so that it is not what it was planned to be."""
