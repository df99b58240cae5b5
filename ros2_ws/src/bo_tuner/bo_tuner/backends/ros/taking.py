"""Takes messages as they are on the wire, with the publisher that each of them is from.

rclpy does not return the publisher of a message. The C library below it, rcl, does, and
`PublisherTaker` calls it.

Reference: ``rcl/subscription.h`` and ``rmw/types.h`` of ROS 2 Jazzy.
"""

import ctypes
from functools import cache
from typing import Any, NamedTuple

from rclpy.subscription import Subscription
from rclpy.utilities import get_rmw_implementation_identifier

OK, TAKE_FAILED = 0, 401
GID_SIZE = 16
"""Bytes of the number that a publisher has in the whole graph."""


class Taken(NamedTuple):
    """A message: its bytes (CDR), when it came in [ns], its number, and its publisher's."""

    data: bytes
    received: int
    number: int | None
    gid: bytes = b""


class _Allocator(ctypes.Structure):
    _fields_ = [
        (name, ctypes.c_void_p)
        for name in ("allocate", "deallocate", "reallocate", "zero_allocate", "state")
    ]


class _Serialized(ctypes.Structure):
    _fields_ = [
        ("buffer", ctypes.c_void_p),
        ("length", ctypes.c_size_t),
        ("capacity", ctypes.c_size_t),
        ("allocator", _Allocator),
    ]


class _Info(ctypes.Structure):
    _fields_ = [
        ("source", ctypes.c_int64),
        ("received", ctypes.c_int64),
        ("number", ctypes.c_uint64),
        ("reception_number", ctypes.c_uint64),
        ("implementation", ctypes.c_char_p),
        ("gid", ctypes.c_uint8 * GID_SIZE),
        # Room for what another distribution may have beside it.
        ("rest", ctypes.c_uint8 * 64),
    ]


class Taker:
    """Takes the messages of a subscription that is in no executor."""

    def __init__(self, subscription: Subscription) -> None:
        self._subscription = subscription

    def take(self) -> Taken | None:
        """Take the next message that waits; None if there is none."""
        item = self._subscription.handle.take_message(self._subscription.msg_type, True)
        if item is None:
            return None
        data, info = item
        return Taken(data, info["received_timestamp"], info["publication_sequence_number"])


class PublisherTaker:
    """Takes the messages of a subscription that is in no executor, each with its publisher."""

    def __init__(self, subscription: Subscription) -> None:
        self._rcl, self._rcutils = _libraries()
        self._subscription = subscription
        self._message = _Serialized()
        self._message.allocator = self._rcutils.rcutils_get_default_allocator()
        self._info = _Info()

    def take(self) -> Taken | None:
        """Take the next message that waits; None if there is none."""
        message, info = self._message, self._info
        status = self._rcl.rcl_take_serialized_message(
            self._subscription.handle.pointer, ctypes.byref(message), ctypes.byref(info), None
        )
        if status != OK:
            # rclpy, too, takes this for no message.
            self._rcutils.rcutils_reset_error()
            return None
        data = ctypes.string_at(message.buffer, message.length)
        return Taken(data, info.received, info.number, bytes(info.gid))

    def __del__(self) -> None:
        """Give the buffer back."""
        if hasattr(self, "_message"):
            self._rcutils.rcutils_uint8_array_fini(ctypes.byref(self._message))


@cache
def _libraries() -> tuple[Any, Any]:
    """Load what rclpy has loaded, by the same names."""
    rcl, rcutils = ctypes.CDLL("librcl.so"), ctypes.CDLL("librcutils.so")
    rcl.rcl_take_serialized_message.argtypes = [
        ctypes.c_void_p, ctypes.POINTER(_Serialized), ctypes.POINTER(_Info), ctypes.c_void_p,
    ]  # fmt: skip
    rcutils.rcutils_get_default_allocator.restype = _Allocator
    rcutils.rcutils_uint8_array_fini.argtypes = [ctypes.POINTER(_Serialized)]
    return rcl, rcutils


def taker(subscription: Subscription, knows_publisher: bool) -> Taker | PublisherTaker:
    """Return what takes the messages of a subscription, with their publishers if that is possible.

    Without them each message is of an unknown publisher.
    """
    if not knows_publisher:
        return Taker(subscription)
    try:
        return PublisherTaker(subscription)
    except (OSError, AttributeError):
        return Taker(subscription)


def middleware() -> str:
    """Name of the middleware, for a message to the user."""
    return str(get_rmw_implementation_identifier())
