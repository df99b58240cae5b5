"""The note, on disk, of what attached nodes had before a tuner came.

A tuner that is killed leaves nodes with the parameters of its last evaluation, and one that ends
may leave them with the study's safe ones. Whoever reads them next must not take these for the
nodes' own.
"""

import contextlib
import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from bo_tuner.backends.ros.isolation import place_name
from bo_tuner.backends.ros.tuner_node import full_name
from bo_tuner.codec.checks import holds, same_value
from bo_tuner.errors import OutputError
from bo_tuner.storage.atomic import write_atomically
from bo_tuner.storage.run_files import read_text
from bo_tuner.storage.state import state_folder
from bo_tuner.text import brief


def said_of_killed(node: str, name: str, value: object) -> str:
    """Say that a parameter of a node has a value of a run that was killed."""
    return f"{node}: {name} is {brief(str(value))}, which a run that was killed has left"


class ParameterNote:
    """The file of one domain and namespace, in which one tuner works at a time.

    It has by the nodes' names what they had when the last tuner came and must have again
    (``previous``, null for no value), by parameter the values that a tuner has set last
    (``assigned``), and what of that they had before the first of several tuners that left it parked
    (``original``), and which they had not declared (``undeclared``). Nodes of other studies stay in
    it.
    """

    def __init__(self, domain: int, namespace: str) -> None:
        self._name = f"{place_name(domain, namespace)}.json"
        self._namespace = namespace
        self._content: dict[str, Any] = {}
        # What cannot be read is of no use, and replaced.
        with contextlib.suppress(
            OutputError, OSError, ValueError, TypeError, KeyError, AttributeError, RecursionError
        ):
            self._content = {
                node: {
                    **{part: dict(item[part]) for part in ("previous", "assigned", "original")},
                    "undeclared": list(item.get("undeclared", [])),
                }
                for node, item in json.loads(read_text(self._path())).items()
            }

    def knows(self, node: str) -> bool:
        """Whether there is something of a node."""
        return bool(self._of(node))

    def assigned(self, node: str) -> Mapping[str, list[object]]:
        """Return the values that were set on a node last, by parameter."""
        values: Mapping[str, list[object]] = self._of(node).get("assigned", {})
        return values

    def note(
        self,
        node: str,
        previous: Mapping[str, object],
        assigned: Mapping[str, list[object]],
        original: Mapping[str, object],
        undeclared: Iterable[str] = (),
    ) -> None:
        """Replace the note on a node; there is none on a node on which nothing was set."""
        name = full_name(self._namespace, node)
        self._content.pop(name, None)
        if assigned or previous:
            self._content[name] = {
                "previous": previous,
                "assigned": assigned,
                "original": original,
                "undeclared": sorted(undeclared),
            }

    def left_behind(self, node: str, now: Mapping[str, object]) -> dict[str, object]:
        """Return what a node had before, of parameters that still have a tuner's value.

        A parameter that has another value by now, since the node was started anew or somebody has
        set it, is not among it.
        """
        previous = self._still_assigned(node, "previous", now)
        return {name: value for name, value in previous.items() if value is not None}

    def left_set(self, node: str, now: Mapping[str, object]) -> set[str]:
        """Return the parameters that still have a tuner's value, and that had none before."""
        previous = self._still_assigned(node, "previous", now)
        return {name for name, value in previous.items() if value is None}

    def undeclared(self, node: str) -> set[str]:
        """Return the parameters that a node had not declared when the last tuner came."""
        return set(self._of(node).get("undeclared", []))

    def original(self, node: str, now: Mapping[str, object]) -> dict[str, object]:
        """Return what a node had before any tuner, of parameters that are still left parked.

        A parameter that has been set since then is not among it.
        """
        return self._still_assigned(node, "original", now)

    def _still_assigned(self, node: str, part: str, now: Mapping[str, object]) -> dict[str, object]:
        noted = self._of(node)
        unchanged = {}
        for name, value in noted.get(part, {}).items():
            assigned = [*noted["assigned"].get(name, []), noted["previous"].get(name)]
            is_assigned = name in now and any(holds(now[name], item) for item in assigned)
            if is_assigned and not same_value(now[name], value):
                unchanged[name] = value
        return unchanged

    def settle(self, node: str) -> None:
        """Take note that a node has again what it had; if that was parked, it still is."""
        noted = self._of(node)
        original = noted.get("original", {})
        self.leave(node, {name: noted["previous"].get(name) for name in original}, original)

    def leave(
        self, node: str, parked: Mapping[str, object], original: Mapping[str, object]
    ) -> None:
        """Take note that a node has what it had, but for what it is left parked with."""
        known = {name: original[name] for name in parked if name in original}
        self.note(node, {}, {name: [value] for name, value in parked.items()}, known)

    def forget(self, node: str, names: Iterable[str]) -> None:
        """Forget parameters of a node, which somebody has set on purpose."""
        noted = self._of(node)
        for name in names:
            for part in ("previous", "original"):
                noted.get(part, {}).pop(name, None)
        if not (noted.get("previous") or noted.get("original")):
            self._content.pop(full_name(self._namespace, node), None)

    def write(self) -> None:
        """Write the content down, or no file of none; raises `OutputError`."""
        path = self._path()
        try:
            if not self._content:
                path.unlink(missing_ok=True)
                return
            path.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
        except OSError as error:
            raise OutputError(f"{path}: cannot be written: {error.strerror}") from error
        write_atomically(path, json.dumps(self._content, default=str))

    def _of(self, node: str) -> dict[str, Any]:
        entry: dict[str, Any] = self._content.get(full_name(self._namespace, node), {})
        return entry

    def _path(self) -> Path:
        return state_folder() / "attached" / self._name
