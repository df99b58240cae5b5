"""The signals of runs in a bag, as the tuner heard them, and the way back.

The messages of the topics alone do not give them again: most have no time of their own, and when
they came in is known to the one who heard them. So the bag of a study with signals has a topic for
each, ``/bo_tuner/signals/<name>``, with one ``std_msgs/msg/Float64MultiArray`` a run: a row of
times [s] since the start of the run, and a row of values.
"""

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.interfaces import Connection
from rosbags.rosbag2 import Reader

from bo_tuner.errors import RunRecordError
from bo_tuner.metrics.recording import RecordedSignal, Recording
from bo_tuner.recording.bag import Message, make_topic, typestore
from bo_tuner.recording.retention import custom_data

TOPICS = "/bo_tuner/signals/"
TYPE = "std_msgs/msg/Float64MultiArray"
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
    store = typestore()
    array, layout, dimension = (
        store.types[f"std_msgs/msg/{name}"]
        for name in ("Float64MultiArray", "MultiArrayLayout", "MultiArrayDimension")
    )
    messages = []
    for name, seen in recording.signals.items():
        count = len(seen.time)
        rows = dimension(label="time [s], value", size=2, stride=2 * count)
        columns = dimension(label="messages", size=count, stride=count)
        data = np.concatenate([seen.time, seen.value]).astype(np.float64)
        message = array(layout=layout(dim=[rows, columns], data_offset=0), data=data)
        topic = make_topic(f"{TOPICS}{name}", TYPE)
        messages.append((topic, bytes(store.serialize_cdr(message, TYPE))))
    return messages


def recording_note(recording: Recording) -> dict[str, object] | None:
    """Return what a recording has beside its messages, for JSON; None without signals."""
    if not recording.signals:
        return None
    counts = {name: [seen.lost, seen.late] for name, seen in recording.signals.items()}
    return {"end": recording.end, "lost_and_late": counts}


def recorded_runs(bag: Path) -> Iterator[RecordedRun]:
    """Read the runs with signals in a bag, in their order.

    Raises
    ------
    RunRecordError
        If it is no bag of a run, or is damaged.
    """
    try:
        data = custom_data(bag)
        evaluations = json.loads(data.get("evaluations", "[]"))
        noted = [item for item in evaluations if item.get(RECORDING)]
        with Reader(bag) as reader:
            of_signals = [c for c in reader.connections if c.topic.startswith(TOPICS)]
            arrays = _arrays(reader, of_signals)
        for k, evaluation in enumerate(noted):
            note = evaluation[RECORDING]
            signals = {
                name: RecordedSignal(*arrays[name][k], int(lost), int(late))
                for name, (lost, late) in note["lost_and_late"].items()
            }
            recording = Recording(signals, float(note["end"]))
            trial = int(evaluation.get("trial", data["trial"]))
            yield RecordedRun(bag.name, trial, evaluation, recording)
    # A damaged file can make its reader raise anything.
    except Exception as error:
        raise RunRecordError(f"{bag}: cannot be read: {str(error)[:200] or error!r}") from error


def _arrays(reader: Reader, connections: list[Connection]) -> dict[str, list[tuple[Any, Any]]]:
    found: dict[str, list[tuple[Any, Any]]] = {}
    if connections:
        for connection, _, raw in reader.messages(connections=connections):
            message: Any = typestore().deserialize_cdr(raw, connection.msgtype)
            times, values = np.array(message.data, dtype=np.float64).reshape(2, -1)
            found.setdefault(connection.topic.removeprefix(TOPICS), []).append((times, values))
    return found
