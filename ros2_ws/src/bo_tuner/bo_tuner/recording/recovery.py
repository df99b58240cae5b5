"""Bags that a kill cut off: made whole from the chunks that reached the disk.

Only as much of MCAP is read as `TrialBag` writes: uncompressed chunks with schemas, channels and
messages, see https://mcap.dev/spec. Whatever is cut off or damaged ends the reading.
"""

import contextlib
import json
import os
import shutil
import struct
from collections.abc import Iterator
from dataclasses import dataclass, field
from io import BytesIO
from itertools import chain
from pathlib import Path
from struct import Struct
from typing import BinaryIO
from zlib import crc32

from bo_tuner.recording.bag import NOTES, PARTIAL, Message, Topic, TrialBag, make_topic
from bo_tuner.recording.retention import BAG_NAME

MAGIC = b"\x89MCAP0\r\n"
SCHEMA, CHANNEL, MESSAGE, CHUNK = 0x03, 0x04, 0x05, 0x06

_RECORD = Struct("<BQ")
_LENGTH = Struct("<I")
_ID = Struct("<H")
_CHANNEL = Struct("<HH")
_MESSAGE = Struct("<HIQQ")
_CHUNK = Struct("<QQQI")
_SIZE = Struct("<Q")


def partial_bags(folder: Path) -> list[Path]:
    """List the bags in `folder` that a run has begun and not finished; none is a link."""
    return sorted(
        path
        for path in folder.glob(f"*{PARTIAL}")
        if BAG_NAME.fullmatch(path.name.removesuffix(PARTIAL))
        and path.is_dir()
        and not path.is_symlink()
    )


def recover(partial: Path) -> Path | None:
    """Make a bag of an unfinished one, with ``complete: false`` in its custom data."""
    path = partial.with_name(partial.name.removesuffix(PARTIAL))
    try:
        notes = json.loads((partial / NOTES).read_text(encoding="utf-8"))
        notes = {str(key): str(value) for key, value in notes.items()}
    except (FileNotFoundError, ValueError, AttributeError):
        notes = {}
    messages = read_messages(partial / path.name / f"{path.name}.mcap")
    first = next(messages, None)
    if first is None:
        shutil.rmtree(partial)
        return None
    # Apart from what is being read, until it is whole.
    repaired = partial.with_name(f".{path.name}")
    bag = TrialBag(repaired / path.name)
    try:
        bag.write(chain([first], messages), notes)
        bag.finish(notes | {"complete": "false"})
        # A whole bag of the same trial is the better record.
        if not path.exists():
            (repaired / path.name).rename(path)
    finally:
        bag.abandon()
        shutil.rmtree(repaired, ignore_errors=True)
    shutil.rmtree(partial)
    return path


@dataclass
class _Tables:
    schemas: dict[int, str] = field(default_factory=dict)
    topics: dict[int, Topic] = field(default_factory=dict)


def read_messages(file: Path) -> Iterator[tuple[int, Message]]:
    """Read times [ns] and messages from the front of an MCAP file, as far as it is whole.

    Nothing is read from a file that does not exist, or that is no MCAP file.
    """
    with contextlib.ExitStack() as stack:
        try:
            data = stack.enter_context(file.open("rb"))
        except FileNotFoundError:
            return
        size = data.seek(0, os.SEEK_END)
        data.seek(0)
        if data.read(len(MAGIC)) != MAGIC:
            return
        tables = _Tables()
        # A chunk at a time: a bag can be larger than the memory.
        for kind, content in _records(data, size):
            if kind != CHUNK:
                continue
            try:
                messages = list(_read_chunk(content, tables))
            except (struct.error, UnicodeDecodeError, KeyError):
                return
            yield from messages


def _records(data: BinaryIO, size: int) -> Iterator[tuple[int, bytes]]:
    """Read whole records from data of so many bytes."""
    left = size - data.tell()
    while left >= _RECORD.size:
        kind, length = _RECORD.unpack(data.read(_RECORD.size))
        left -= _RECORD.size + length
        if left < 0:
            return
        yield kind, data.read(length)


def _read_chunk(chunk: bytes, tables: _Tables) -> Iterator[tuple[int, Message]]:
    _, _, _, checksum = _CHUNK.unpack_from(chunk)
    compression, position = _read_text(chunk, _CHUNK.size)
    (size,) = _SIZE.unpack_from(chunk, position)
    records = chunk[position + _SIZE.size :]
    if compression or size != len(records) or (checksum and checksum != crc32(records)):
        raise KeyError(f"chunk with compression {compression!r}, {len(records)} of {size} bytes")
    for kind, content in _records(BytesIO(records), len(records)):
        if kind == SCHEMA:
            (number,) = _ID.unpack_from(content)
            tables.schemas[number], _ = _read_text(content, _ID.size)
        elif kind == CHANNEL:
            number, schema = _CHANNEL.unpack_from(content)
            name, _ = _read_text(content, _CHANNEL.size)
            tables.topics[number] = make_topic(name, tables.schemas[schema])
        elif kind == MESSAGE:
            number, _, time, _ = _MESSAGE.unpack_from(content)
            yield time, (tables.topics[number], content[_MESSAGE.size :])


def _read_text(data: bytes, position: int) -> tuple[str, int]:
    (length,) = _LENGTH.unpack_from(data, position)
    start = position + _LENGTH.size
    if start + length > len(data):
        raise struct.error("text is cut off")
    return data[start : start + length].decode(), start + length
