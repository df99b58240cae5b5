"""Evaluations that came to nothing: run again, and counted, as too many in a row end a run."""

from collections.abc import Mapping

from bo_tuner.errors import RunError
from bo_tuner.run_notes import Unusable
from bo_tuner.trials import Evaluation, EvaluationState, Outcome

DEADLY = 2
"""Runs of a test run in which a node dies until that is a failure of the parameters."""
MOST_DEATHS = 10
"""Runs of a test run in which a node dies that does so anyway, until it is lost."""
LOST_IN_A_ROW = 3
"""Number of consecutive losses that ends a run: the nodes are gone, or not ours alone."""

HOW: Mapping[str, str] = {
    EvaluationState.LOST: "were lost with their nodes",
    Unusable.DISTURBED: "were disturbed",
    Unusable.UNPREPARED: "could not be prepared",
    Unusable.WITHDRAWN: "were withdrawn",
}


class Attempts:
    """Attempts at one evaluation after the other, told in their order.

    One that was lost or disturbed is run up to `most` times. One in which a node dies twice has
    failed; one in which a node dies that does so whatever the parameters is run until it comes to
    its end, up to `MOST_DEATHS` times.
    """

    def __init__(self, most: int) -> None:
        self._most = most
        self._begin()

    def _begin(self) -> None:
        self._failed = self._died = self._died_anyway = 0

    def judged(self, outcome: Outcome) -> Outcome:
        """Return an outcome with what the attempts before it make of it."""
        if not outcome.unusable:
            return outcome.noted(deaths=self._died_anyway) if self._died_anyway else outcome
        death = outcome.notes.death
        if death is not None and not death.anyway and self._died + 1 == DEADLY:
            return outcome.died_of_parameters(death.node)
        return outcome

    def is_due_again(self, judged: Outcome) -> bool:
        """Take an outcome as it was judged; returns whether its evaluation is to be run again."""
        again = judged.unusable and self._count(judged)
        if not again:
            self._begin()
        return again

    def _count(self, unusable: Outcome) -> bool:
        """Count an attempt that came to nothing; returns whether another one is to be made."""
        if (death := unusable.notes.death) is None:
            self._failed += 1
            return self._failed < self._most
        if not death.anyway:
            self._died += 1
            return True
        self._died_anyway += 1
        return self._died_anyway < MOST_DEATHS


class Losses:
    """Counter of tasks in a row with an unusable outcome, see `Outcome.unusable`."""

    def __init__(self, what: str) -> None:
        self._what = what
        self._in_a_row: list[Outcome] = []

    def note(self, evaluation: Evaluation | None) -> None:
        """Count a task by its unusable evaluation; None, or one on record, resets the counter.

        One on record belongs to an earlier session; its user has brought the nodes back since.
        """
        if evaluation is not None and not evaluation.recorded:
            self._in_a_row.append(evaluation.outcome)
        else:
            self._in_a_row.clear()

    def check(self) -> None:
        """End the run after too many in a row."""
        if len(self._in_a_row) < LOST_IN_A_ROW:
            return
        last = self._in_a_row[-1]
        raise RunError(
            f"{len(self._in_a_row)} {self._what} in a row {HOW[last.ending]}: {last.reason}"
        )
