"""The messages of tuner and guard, as lines of JSON in a pipe or a ``std_msgs/String``."""

import json
from dataclasses import dataclass
from typing import Self

from rclpy.qos import QoSDurabilityPolicy, QoSProfile

from bo_tuner.codec.reading import JSON, read
from bo_tuner.codec.writing import to_json

GUARD = "bo_tuner_guard"
"""Name of a guard's node; it begins like all those of the tuner."""
STATE_TOPIC = f"/{GUARD}/state"
BEAT_TOPIC = f"/{GUARD}/beat"
LATEST = QoSProfile(depth=1, durability=QoSDurabilityPolicy.TRANSIENT_LOCAL)
"""Of each guard the latest state; reliable, so that who joins late knows it."""
BEATS = QoSProfile(depth=10)

PERIOD = 0.1
"""Time [s] between two heartbeats, and between two states."""

IDLE, RUN, END = "idle", "run", "end"
"""Phases: between runs; in a run, in which the abort condition counts; no further beat comes."""


@dataclass(frozen=True)
class _Message:
    @classmethod
    def read(cls, text: str | bytes) -> Self | None:
        """Return the message in a text; None if it is another one."""
        try:
            message: Self = read(cls, json.loads(text), JSON)
        except (ValueError, RecursionError):
            # Anybody may publish anything.
            return None
        return message

    def __str__(self) -> str:
        return json.dumps(to_json(self))


@dataclass(frozen=True)
class Beat(_Message):
    """A heartbeat of the tuner.

    Attributes
    ----------
    guard : str
        Whom it is for.
    phase : str
        `IDLE`, `RUN` or `END`.
    run : int
        Counts the runs: a condition of one says nothing of the next.
    acts : int
        How often the guard has acted, as far as the tuner knows and has drawn the consequences.
    """

    guard: str
    phase: str
    run: int
    acts: int


@dataclass(frozen=True)
class State(_Message):
    """The state of a guard.

    Attributes
    ----------
    guard : str
        A random name of the process.
    digest, study : str
        Of its plan.
    nodes, topics : tuple of str
        Full names of the nodes that it guards, and of the topics that it would publish.
    acts : int
        How often it has acted.
    reason : str
        Why it acted last.
    outcome : str
        What came of that, in words; empty while it acts.
    takes_over : bool
        Whether the tuner was not in control: somebody must see to the machine before it goes on.
    on_condition : bool
        Whether it acted on the abort condition.
    ends : bool
        Whether it watches no longer.
    stands : bool
        Whether it outlives a tuner, and takes heartbeats from any.
    settled : bool
        Whether no other guard has its nodes, so that it stays.
    watches : bool
        Whether it hears a tuner, and acts if that falls silent.
    """

    guard: str
    digest: str
    study: str
    nodes: tuple[str, ...]
    topics: tuple[str, ...]
    acts: int = 0
    reason: str = ""
    outcome: str = ""
    takes_over: bool = False
    on_condition: bool = False
    ends: bool = False
    stands: bool = False
    settled: bool = False
    watches: bool = False
