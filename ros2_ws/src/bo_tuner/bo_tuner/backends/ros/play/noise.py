"""Noise that is added to messages while they are played."""

import zlib
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from rclpy.serialization import serialize_message

from bo_tuner.backends.ros.decoding import decode
from bo_tuner.backends.ros.fields import field_reader
from bo_tuner.backends.ros.messages import interface_class
from bo_tuner.backends.ros.number_writer import number_writer
from bo_tuner.codec.findings import under
from bo_tuner.errors import StudyError
from bo_tuner.study.fields import FieldPath, parsed_field


class Noise:
    """Adds white noise to numbers in the messages of a topic, each time that it is made the same.

    Parameters
    ----------
    topic
        The topic.
    kind
        Type of its messages.
    amounts
        Standard deviations by field.
    """

    def __init__(self, topic: str, kind: str, amounts: Mapping[str, float]) -> None:
        self._rng = np.random.default_rng(zlib.crc32(topic.encode()))
        self._cls: Any = interface_class(kind)
        self._fields: list[tuple[FieldPath, Callable[[Any], float], float]] = []
        for text, amount in amounts.items():
            with under(text):
                path = parsed_field(text)
                if not isinstance(path, tuple):
                    raise StudyError("expected a field alone, such as angular_velocity.z")
                number_writer(self._cls(), path)
                self._fields.append((path, field_reader(self._cls, path), amount))

    def __call__(self, data: bytes) -> bytes:
        """Return a message with noise."""
        message = decode(data, self._cls)
        for path, read, amount in self._fields:
            number_writer(message, path).write(read(message) + amount * self._rng.normal())
        return bytes(serialize_message(message))
