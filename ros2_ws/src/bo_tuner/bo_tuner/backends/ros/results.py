"""The results of the present evaluation, out of all that is published as a result."""

NO_RUN = ""
MOST_EARLY = 100
"""Evaluations of which results are kept while the present one's identifier is not known."""


class RunResults:
    """Keeps what the nodes say of the present evaluation, and counts what does not belong to it.

    Between `begin` and `identify` the evaluation runs, but its identifier is still on its way, and
    a result may be faster. Of a node's results the first one counts; another one of the same
    evaluation contradicts it.
    """

    def __init__(self) -> None:
        self._evaluation: str | None = NO_RUN
        self._said: dict[str, dict[str, dict[str, object]]] = {}
        self._ignored = 0
        self._contradicted: set[tuple[str, str]] = set()
        self.problem = ""
        """What came in the present evaluation as a result, but cannot be read."""

    def begin(self) -> None:
        """Take the results of an evaluation whose identifier is not known yet."""
        self._contradicted = set()
        self.problem = ""
        self._evaluation = None

    def identify(self, evaluation: str) -> None:
        """Take the results of `evaluation` only."""
        self._evaluation = evaluation
        for other in self._said.keys() - {evaluation}:
            self._forget(other)

    def end(self) -> None:
        """Take none until the next evaluation begins."""
        self._said.pop(self._evaluation or NO_RUN, None)
        self.identify(NO_RUN)

    @property
    def said(self) -> dict[str, dict[str, object]]:
        """What came of the present evaluation, by node key."""
        return dict(self._said.get(self._evaluation or NO_RUN, {}))

    def add(self, key: str, pairs: dict[str, object]) -> None:
        """Take a result of the node `key`; its key ``cut`` names the evaluation it belongs to."""
        evaluation = str(pairs.get("cut", NO_RUN))
        repeated = key in self._said.get(evaluation, {})
        if repeated and pairs != self._said[evaluation][key]:
            self._contradicted.add((evaluation, key))
        if evaluation == NO_RUN or repeated or self._evaluation not in (None, evaluation):
            self._ignored += 1
            return
        self._said.setdefault(evaluation, {})[key] = pairs
        if len(self._said) > MOST_EARLY:
            self._forget(next(iter(self._said)))

    def add_unreadable(self, problem: str) -> None:
        """Take note of a result that cannot be read, and so may be of any evaluation."""
        self._ignored += 1
        self.problem = self.problem or problem

    @property
    def contradicted(self) -> list[str]:
        """Keys of the nodes of which there are different results of the present evaluation."""
        present = self._evaluation
        return sorted(key for evaluation, key in self._contradicted if evaluation == present)

    def take_ignored(self) -> int:
        """Return how many results belonged to no evaluation of ours since this was last asked."""
        count, self._ignored = self._ignored, 0
        return count

    def _forget(self, evaluation: str) -> None:
        self._ignored += len(self._said.pop(evaluation))
