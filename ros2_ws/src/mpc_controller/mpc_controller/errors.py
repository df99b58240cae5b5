"""Errors of the controller package."""


class ControllerError(Exception):
    """Base of all errors that this package raises on purpose."""


class SettingsError(ControllerError, ValueError):
    """A value, or a set of values, breaks a rule of the parameter table."""
