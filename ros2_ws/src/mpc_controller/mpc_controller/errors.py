"""Errors of the controller package."""

from feed_axis_common.errors import FeedAxisError


class ControllerError(FeedAxisError):
    """A reference or a set of parameters that the controller cannot work with."""
