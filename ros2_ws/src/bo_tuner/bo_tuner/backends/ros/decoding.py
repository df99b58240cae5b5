"""Messages as they are on the wire, decoded only if they are not too large.

A subscription with ``raw=True`` gives them so. Answers of services come decoded.
"""

from typing import Any

from rclpy.serialization import deserialize_message

from bo_tuner import maxima


class UnreadableError(Exception):
    """A message that is too large, or none of its type; the text follows its name."""


def decode(data: bytes, message_class: Any) -> Any:
    """Decode a message."""
    if len(data) > maxima.MESSAGE_BYTES:
        raise UnreadableError(f"has {len(data)} bytes, expected at most {maxima.MESSAGE_BYTES}")
    try:
        return deserialize_message(data, message_class)
    except RuntimeError:
        raise UnreadableError(f"cannot be read as {message_class.__name__}") from None
