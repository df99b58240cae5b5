"""Messages as they are on the wire and in bags, read without ROS.

The objects have the fields of the ROS classes, by the same names; their arrays are NumPy's.
"""

from collections.abc import Sequence
from functools import cache
from typing import Any

from rosbags.typesys import Stores, get_typestore
from rosbags.typesys.store import Typestore

from bo_tuner.ros_distribution import distribution


@cache
def typestore() -> Typestore:
    """Return the message definitions of the ROS distribution that is installed, or of Jazzy."""
    try:
        return get_typestore(Stores(f"ros2_{distribution()}"))
    except ValueError:
        return get_typestore(Stores.LATEST)


def is_known(message_type: str) -> bool:
    """Whether messages of a type can be read."""
    return message_type in typestore().fielddefs


def decoded(message_type: str, data: Sequence[bytes]) -> list[Any]:
    """Return the messages (n) of their bytes (CDR)."""
    return [typestore().deserialize_cdr(item, message_type) for item in data]
