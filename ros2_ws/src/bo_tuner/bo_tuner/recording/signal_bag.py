"""The signals of runs in a bag, as the tuner heard them, and the way back.

The messages of the topics alone do not give them again: most have no time of their own, and when
they came in is known to the one who heard them. So the bag of a study with signals has a topic for
each, ``/bo_tuner/signals/<name>``, with one ``std_msgs/msg/Float64MultiArray`` a run: a row of
times [s] since the start of the run, and a row of values. Of a signal of whole messages that has
the times only, and ``/bo_tuner/messages/<name>`` the messages themselves, one behind the other: one
``std_msgs/msg/UInt8MultiArray`` a run with the size of each in its layout, so that they keep their
order whatever their stamps are.
"""

import itertools
import json
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.rosbag2 import Reader

from bo_tuner.errors import RunRecordError
from bo_tuner.metrics.recording import RecordedMessages, RecordedSignal, Recording
from bo_tuner.metrics.stored_messages import typestore
from bo_tuner.recording.bag import Message, make_topic
from bo_tuner.recording.retention import custom_data

TOPICS = "/bo_tuner/signals/"
TYPE = "std_msgs/msg/Float64MultiArray"
MESSAGES = "/bo_tuner/messages/"
MESSAGES_TYPE = "std_msgs/msg/UInt8MultiArray"
RECORDING = "recording"
"""Key, in what a bag's custom data say of an evaluation, of the rest of its recording."""


@dataclass(frozen=True)
class RecordedRun:
    """A run in a bag.

    Attributes
    ----------
    bag
        Name of the bag.
    evaluation
        What the bag says of the evaluation: its index, stage, parameters, metrics and so on.
    trial
        The number of its trial.
    recording
        Its signals.
    """

    bag: str
    trial: int
    evaluation: Mapping[str, Any]
    recording: Recording


def signal_messages(recording: Recording) -> list[Message]:
    """Return a message for each signal of a run."""
    messages = []
    for name, seen in recording.signals.items():
        rows = [("time [s], value", 2), ("messages", len(seen.time))]
        data = np.concatenate([seen.time, seen.value]).astype(np.float64)
        messages.append(_array(f"{TOPICS}{name}", TYPE, rows, data))
    for name, heard in recording.messages.items():
        rows = [("time [s]", 1), ("messages", len(heard.time))]
        messages.append(_array(f"{TOPICS}{name}", TYPE, rows, heard.time.astype(np.float64)))
        sizes = [("message", len(item)) for item in heard.data]
        raw = np.frombuffer(b"".join(heard.data), dtype=np.uint8)
        messages.append(_array(f"{MESSAGES}{name}", MESSAGES_TYPE, sizes, raw))
    return messages


def _array(topic: str, kind: str, sizes: Sequence[tuple[str, int]], data: Any) -> Message:
    """Return a message with an array, and the labels and sizes of its dimensions."""
    store = typestore()
    array, layout, dimension = (
        store.types[name]
        for name in (kind, "std_msgs/msg/MultiArrayLayout", "std_msgs/msg/MultiArrayDimension")
    )
    dims = []
    for k, (label, size) in enumerate(sizes):
        # Of the sizes of parts that stand one behind the other there is no stride.
        stride = math.prod(size for _, size in sizes[k:]) if kind == TYPE else 0
        dims.append(dimension(label=label, size=size, stride=stride))
    message = array(layout=layout(dim=dims, data_offset=0), data=data)
    return make_topic(topic, kind), bytes(store.serialize_cdr(message, kind))


def recording_note(recording: Recording) -> dict[str, object] | None:
    """Return what a recording has beside its messages, for JSON; None without signals."""
    if not recording.signals and not recording.messages:
        return None
    counts = {
        name: [seen.lost, seen.late]
        for name, seen in (*recording.signals.items(), *recording.messages.items())
    }
    types = {name: heard.type for name, heard in recording.messages.items()}
    return {"end": recording.end, "lost_and_late": counts} | ({"types": types} if types else {})


def recorded_runs(bag: Path) -> Iterator[RecordedRun]:
    """Read the runs with signals in a bag, in their order."""
    try:
        data_of_bag = custom_data(bag)
        evaluations = json.loads(data_of_bag.get("evaluations", "[]"))
        noted = [item for item in evaluations if item.get(RECORDING)]
        with Reader(bag) as reader:
            arrays = _arrays(reader, TOPICS)
            raw = _arrays(reader, MESSAGES)
        for k, evaluation in enumerate(noted):
            note = evaluation[RECORDING]
            types = note.get("types", {})
            signals, messages = {}, {}
            for name, counts in note["lost_and_late"].items():
                lost, late = map(int, counts)
                times = np.array(arrays[name][k].data, dtype=np.float64)
                if name in types:
                    data = _split(raw[name][k])
                    messages[name] = RecordedMessages(
                        times, types[name], data, lost=lost, late=late
                    )
                    continue
                signals[name] = RecordedSignal(*times.reshape(2, -1), lost=lost, late=late)
            recording = Recording(signals, float(note["end"]), messages)
            trial = int(evaluation.get("trial", data_of_bag["trial"]))
            yield RecordedRun(bag.name, trial, evaluation, recording)
    # A damaged file can make its reader raise anything.
    except Exception as error:
        raise RunRecordError(f"{bag}: cannot be read: {str(error)[:200] or error!r}") from error


def _arrays(reader: Reader, topics: str) -> dict[str, list[Any]]:
    """Return the messages of the topics below a name, one a run, by the rest of their names."""
    messages: dict[str, list[Any]] = {}
    connections = [c for c in reader.connections if c.topic.startswith(topics)]
    if connections:
        for connection, _, raw in reader.messages(connections=connections):
            message = typestore().deserialize_cdr(raw, connection.msgtype)
            messages.setdefault(connection.topic.removeprefix(topics), []).append(message)
    return messages


def _split(array: Any) -> tuple[bytes, ...]:
    """Return the messages that stand one behind the other in an array."""
    data, ends = bytes(array.data), np.cumsum([0, *(dim.size for dim in array.layout.dim)])
    return tuple(data[begin:end] for begin, end in itertools.pairwise(ends))
