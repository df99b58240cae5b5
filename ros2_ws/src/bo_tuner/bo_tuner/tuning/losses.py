"""Counting consecutive losses, which end a run."""

from collections.abc import Mapping

from bo_tuner.errors import RunError
from bo_tuner.run_notes import Unusable
from bo_tuner.trials import Evaluation, EvaluationState, Outcome

LOST_IN_A_ROW = 3
"""Number of consecutive losses that ends a run: the nodes are gone, or not ours alone."""

HOW: Mapping[str, str] = {
    EvaluationState.LOST: "were lost with their nodes",
    Unusable.DISTURBED: "were disturbed",
    Unusable.UNPREPARED: "could not be prepared",
    Unusable.WITHDRAWN: "were withdrawn",
}


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
