"""Errors of the feed axis's packages."""


class FeedAxisError(Exception):
    """Base of all errors that these packages raise on purpose."""


class SettingsError(FeedAxisError, ValueError):
    """A value, or a set of values, breaks a rule of the parameter table."""


class MessageError(FeedAxisError, ValueError):
    """A message lacks what its reader needs."""
