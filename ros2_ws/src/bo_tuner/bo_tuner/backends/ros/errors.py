"""Why an evaluation on ROS nodes does not count."""


class LostError(Exception):
    """A node died, or is not there."""


class DiedError(LostError):
    """A node that the tuner has started has ended by itself.

    Attributes
    ----------
    key
        Of the node in the study.
    """

    def __init__(self, reason: str, key: str) -> None:
        super().__init__(reason)
        self.key = key


class SilentError(LostError):
    """A node does not answer in time."""


class RefusedError(Exception):
    """A node refused its parameters, or did not take their values."""


class UnpreparedError(Exception):
    """The steps before a run failed with the safe parameters: the run did not begin."""


class DisturbedError(Exception):
    """Somebody else has a hand in the evaluation, so that it is not what it was planned to be."""
