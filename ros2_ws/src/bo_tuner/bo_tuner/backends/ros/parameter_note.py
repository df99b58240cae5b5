"""The note of what attached nodes had before a tuner came.

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
from bo_tuner.errors import OutputError
from bo_tuner.storage.atomic import write_atomically
from bo_tuner.storage.run_files import read_text
from bo_tuner.storage.state import state_folder
from bo_tuner.study.checks import same_value
from bo_tuner.text import brief


def said_of_killed(node: str, name: str, value: object) -> str:
    """Tell that a parameter of a node has a value of a run that was killed."""
    return f"{node}: {name} is {brief(str(value))}, which a run that was killed has left"


class ParameterNote:
    """The file of one domain and namespace, in which one tuner works at a time.

    Parameters
    ----------
    domain
        The ROS domain.
    namespace
        The namespace of the tuner.

    Attributes
    ----------
    content : dict
        By the nodes' names what they had when the last tuner came and must have again
        (``previous``), by parameter the values that a tuner has told them last (``told``), and what
        of that they had before the first of several tuners that left it parked (``original``).
        Nodes of other studies stay in it.
    """

    def __init__(self, domain: int, namespace: str) -> None:
        self._name = f"{place_name(domain, namespace)}.json"
        self.content: dict[str, Any] = {}
        # What cannot be read is of no use, and replaced.
        with contextlib.suppress(
            OutputError, OSError, ValueError, TypeError, KeyError, AttributeError, RecursionError
        ):
            self.content = {
                node: {part: dict(item[part]) for part in ("previous", "told", "original")}
                for node, item in json.loads(read_text(self._path())).items()
            }

    def left_behind(self, node: str, now: Mapping[str, object]) -> dict[str, object]:
        """Return what a node had before, of what it still has as a tuner has told it.

        A parameter that has another value by now, since the node was started anew or somebody has
        set it, is not among it.
        """
        return self._told(node, "previous", now)

    def original(self, node: str, now: Mapping[str, object]) -> dict[str, object]:
        """Return what a node had before any tuner, of what it still has as one has left it parked.

        As in `left_behind`, what has been set since then is not among it.
        """
        return self._told(node, "original", now)

    def _told(self, node: str, part: str, now: Mapping[str, object]) -> dict[str, object]:
        noted = self.content.get(node, {})
        found = {}
        for name, value in noted.get(part, {}).items():
            told = [*noted["told"].get(name, []), noted["previous"].get(name)]
            is_told = name in now and any(same_value(now[name], item) for item in told)
            if is_told and not same_value(now[name], value):
                found[name] = value
        return found

    def settle(self, node: str) -> None:
        """Take note that a node has again what it had; if that was parked, it still is."""
        noted = self.content.pop(node, {})
        parked = {name: noted["previous"].get(name) for name in noted.get("original", {})}
        if parked:
            self.content[node] = {
                "previous": {},
                "told": {name: [value] for name, value in parked.items()},
                "original": noted["original"],
            }

    def forget(self, node: str, names: Iterable[str]) -> None:
        """Forget parameters of a node, which somebody has set on purpose."""
        noted = self.content.get(node, {})
        for name in names:
            for part in ("previous", "original"):
                noted.get(part, {}).pop(name, None)
        if not (noted.get("previous") or noted.get("original")):
            self.content.pop(node, None)

    def write(self) -> None:
        """Write the content down, or no file of none; raises `OutputError`."""
        path = self._path()
        try:
            if not self.content:
                path.unlink(missing_ok=True)
                return
            path.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
        except OSError as error:
            raise OutputError(f"{path}: cannot be written: {error.strerror}") from error
        write_atomically(path, json.dumps(self.content, default=str))

    def _path(self) -> Path:
        return state_folder() / "attached" / self._name
