"""The options of a session that the next one of the same run goes on with."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated

from bo_tuner.codec.reading import JSON, read
from bo_tuner.codec.rules import Count, Whole
from bo_tuner.codec.writing import changes

OPTIONS = "options"
"""Their key in the provenance of a session."""


@dataclass(frozen=True, kw_only=True)
class SessionOptions:
    """What a session was told, which counts on unless a later one is told otherwise.

    Attributes
    ----------
    stop_early
        Whether it follows the advice to stop.
    attached
        Whether it used running nodes.
    namespace
        In which it looked for nodes; empty where that is not on record.
    window
        How many trials, or other tasks, were planned at once; a run keeps it.
    workers
        How many evaluations it ran at once.
    scheduler
        Address of the cluster whose workers it used; empty for none.
    benches
        The sets of running nodes that it used, one a worker.
    record, record_limit
        Which bags to keep, and their size together [byte]; empty and None where that is not on
        record.
    """

    stop_early: bool = False
    attached: bool = False
    namespace: str = ""
    window: Annotated[int, Whole(1)] = 1
    workers: Annotated[int, Whole(1)] = 1
    scheduler: str = ""
    benches: tuple[str, ...] = ()
    record: str = ""
    record_limit: Count | None = None

    @property
    def provenance(self) -> dict[str, str]:
        """What the provenance of the session has of them."""
        return {OPTIONS: json.dumps(changes(self))}


def options_of(provenance: Mapping[str, str]) -> SessionOptions:
    """Return the options that are on record; the defaults where none can be read."""
    try:
        options: SessionOptions = read(
            SessionOptions, json.loads(provenance.get(OPTIONS, "{}")), JSON
        )
    except (ValueError, RecursionError):
        return SessionOptions()
    return options
