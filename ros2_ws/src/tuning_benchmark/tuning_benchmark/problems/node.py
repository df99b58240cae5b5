"""What the nodes of closed-form problems have in common."""

from collections.abc import Mapping
from typing import Any


class ParameterizedNode:
    """A node that takes any parameter; what it evaluates is up to its subclass.

    Attributes
    ----------
    values : dict
        The parameters that were set last, by name.
    """

    def __init__(self) -> None:
        self.values: dict[str, Any] = {}

    def set_parameters(self, values: Mapping[str, Any]) -> None:
        """Take settings, parameters, contexts and the seed."""
        self.values |= values
