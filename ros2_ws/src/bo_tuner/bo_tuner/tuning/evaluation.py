"""Running one evaluation, and counting consecutive losses."""

from bo_tuner.backends.protocol import Backend
from bo_tuner.errors import RunError
from bo_tuner.trials import DISTURBED, UNPREPARED, Evaluation, EvaluationState, Outcome
from bo_tuner.tuning.observer import RunObserver

LOST_IN_A_ROW = 3
"""Number of consecutive losses that ends a run: the nodes are gone, or not ours alone."""


def evaluate(backend: Backend, planned: Evaluation, observer: RunObserver) -> Evaluation:
    """Run a planned evaluation and pass the result to the observer.

    Parameters
    ----------
    backend
        Runs the evaluation; open.
    planned
        The evaluation, without an outcome.
    observer
        Is passed the result.

    Returns
    -------
    Evaluation
        The planned one with its outcome and wall time.
    """
    (evaluation,) = backend.run([planned])
    observer.evaluation(evaluation)
    return evaluation


HOW = {
    EvaluationState.LOST: "were lost with their nodes",
    DISTURBED: "were disturbed",
    UNPREPARED: "could not be prepared",
}


class Losses:
    """Counter of spoilt outcomes in a row, see `Outcome.spoilt`; ends the run at `LOST_IN_A_ROW`.

    Parameters
    ----------
    what
        What is counted, in the plural, for the error message.
    """

    def __init__(self, what: str) -> None:
        self._what = what
        self._in_a_row: list[Outcome] = []

    def note(self, evaluation: Evaluation | None) -> None:
        """Count a spoilt evaluation; any other, one on record, or None resets the counter.

        Those on record ended an earlier session: whoever resumes it has the nodes again.
        """
        if evaluation is not None and evaluation.outcome.spoilt and not evaluation.recorded:
            self._in_a_row.append(evaluation.outcome)
        else:
            self._in_a_row.clear()

    def check(self) -> None:
        """End the run after too many in a row.

        Raises
        ------
        RunError
            After `LOST_IN_A_ROW` losses in a row.
        """
        if len(self._in_a_row) < LOST_IN_A_ROW:
            return
        last = self._in_a_row[-1]
        raise RunError(
            f"{len(self._in_a_row)} {self._what} in a row {HOW[last.ending]}: {last.reason}"
        )
