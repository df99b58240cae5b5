"""What a worker says of what it was asked for."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from bo_tuner.backends.protocol import Backend
from bo_tuner.trials import Evaluation

MakeBackend = Callable[[int, Path, Callable[[], None]], Backend]
"""Makes the backend of a worker: by its number, a folder of its host that it may write to, and what
to call while it waits."""


@dataclass(frozen=True)
class Answer:
    """What a worker says of what it was asked for.

    Attributes
    ----------
    worker
        Its number, from 1, or in a cluster its address.
    evaluation
        That it has run; None for anything else.
    problem
        Why it cannot go on; empty if it can.
    remarks
        What went wrong beside, each in a line.
    returned
        Whether the problem is what a function has returned, which is no result.
    heard
        What was heard in the evaluation, by a backend that listens; for whoever made that.
    """

    worker: str
    evaluation: Evaluation | None = None
    problem: str = ""
    remarks: tuple[str, ...] = ()
    returned: bool = False
    heard: object = None
