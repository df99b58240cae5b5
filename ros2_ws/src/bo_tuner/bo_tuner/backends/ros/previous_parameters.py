"""What attached nodes had before a tuner came, on disk until they have it again.

A tuner that is killed leaves nodes with the parameters of its last evaluation. The next one that is
attached to them must not take these for the nodes' own, and set them back to them in the end.
"""

import contextlib
import json
from collections.abc import Iterable, Mapping
from typing import Any

from bo_tuner.errors import OutputError
from bo_tuner.storage.atomic import write_atomically
from bo_tuner.storage.run_files import read_text
from bo_tuner.storage.state import state_folder
from bo_tuner.study.checks import same_value

Values = Mapping[str, Mapping[str, object]]
"""Parameters by node, then by name."""


class PreviousParameters:
    """The note of one domain and namespace, in which one tuner works at a time.

    Parameters
    ----------
    domain
        The ROS domain.
    namespace
        The tuner's.
    """

    def __init__(self, domain: int, namespace: str) -> None:
        name = f"domain{domain}{namespace.rstrip('/').replace('/', '-')}.json"
        self._path = state_folder() / "attached" / name
        self._previous: dict[str, dict[str, object]] = {}
        self._safe: Values = {}

    def left_behind(self, present: Values) -> dict[str, dict[str, object]]:
        """Return what nodes had before a tuner that was killed, of what they still have from it.

        A parameter that has another value by now, since the node was started anew or somebody has
        set it, stays as it is.

        Parameters
        ----------
        present
            What the nodes have.

        Returns
        -------
        dict
            By node and name the values before; without nodes of which nothing is left.
        """
        found: dict[str, dict[str, object]] = {}
        for node, noted in self._noted().items():
            now = present.get(node, {})
            for name, value in noted["previous"].items():
                told = noted["told"].get(name, [])
                is_told = name in now and any(same_value(now[name], item) for item in told)
                if is_told and not same_value(now[name], value):
                    found.setdefault(node, {})[name] = value
        return found

    def begin(self, previous: Values, safe: Values) -> None:
        """Note what nodes have, and what they will have between evaluations.

        Raises
        ------
        OutputError
            If it cannot be written.
        """
        self._previous = {node: dict(values) for node, values in previous.items()}
        self._safe = safe
        self.tell({})

    def tell(self, told: Values) -> None:
        """Note what nodes are about to have, ahead of telling them; raises as `begin`."""
        if not self._previous:
            return
        content = {}
        for node, values in self._previous.items():
            sets = (self._safe.get(node, {}), told.get(node, {}))
            by_name = {name: [s[name] for s in sets if name in s] for name in values}
            content[node] = {"previous": values, "told": by_name}
        try:
            self._path.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
        except OSError as error:
            raise OutputError(f"{self._path}: cannot be written: {error.strerror}") from error
        write_atomically(self._path, json.dumps(content, default=str))

    def end(self, nodes: Iterable[str]) -> None:
        """Forget nodes, which have what they had before; what others had stays on disk."""
        for node in nodes:
            self._previous.pop(node, None)
        with contextlib.suppress(OSError, OutputError):
            if self._previous:
                self.tell({})
            else:
                self._path.unlink(missing_ok=True)

    def _noted(self) -> dict[str, Any]:
        """Return the content of the file; nothing if there is none that can be used."""
        try:
            content = json.loads(read_text(self._path))
            return {
                str(node): {"previous": dict(item["previous"]), "told": dict(item["told"])}
                for node, item in content.items()
            }
        except (OSError, ValueError, TypeError, KeyError, AttributeError, RecursionError):
            return {}
