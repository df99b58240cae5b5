"""The results of the present cut, out of all that is published as a result."""

NO_CUT = ""
MOST_EARLY = 100
"""Cuts of which results are kept while the present one's identifier is not known."""


class CutResults:
    """Keeps what the nodes say of the present cut, and counts what does not belong to it.

    Between `begin` and `identify` the cut runs, but its identifier is still on its way, and a
    result may be faster. Of a node's results the first one counts.
    """

    def __init__(self) -> None:
        self._cut: str | None = NO_CUT
        self._said: dict[str, dict[str, dict[str, object]]] = {}
        self._ignored = 0

    def begin(self) -> None:
        """Take the results of a cut whose identifier is not known yet."""
        self._cut = None

    def identify(self, cut: str) -> None:
        """Take the results of `cut` only."""
        self._cut = cut
        for other in self._said.keys() - {cut}:
            self._forget(other)

    def end(self) -> None:
        """Take none until the next cut begins."""
        self._said.pop(self._cut or NO_CUT, None)
        self.identify(NO_CUT)

    @property
    def said(self) -> dict[str, dict[str, object]]:
        """What came of the present cut, by node key."""
        return dict(self._said.get(self._cut or NO_CUT, {}))

    def add(self, key: str, pairs: dict[str, object]) -> None:
        """Take a result of the node `key`; its key ``cut`` tells which cut it belongs to."""
        cut = str(pairs.get("cut", NO_CUT))
        repeated = key in self._said.get(cut, {})
        if cut == NO_CUT or repeated or self._cut not in (None, cut):
            self._ignored += 1
            return
        self._said.setdefault(cut, {})[key] = pairs
        if len(self._said) > MOST_EARLY:
            self._forget(next(iter(self._said)))

    def take_ignored(self) -> int:
        """Return how many results belonged to no cut of ours since this was last asked."""
        count, self._ignored = self._ignored, 0
        return count

    def _forget(self, cut: str) -> None:
        self._ignored += len(self._said.pop(cut))
