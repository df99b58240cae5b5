"""One evaluation: run, checked, and told to the observer."""

from dataclasses import replace

from bo_tuner.backends.protocol import Backend
from bo_tuner.errors import RunError
from bo_tuner.study.study import Study
from bo_tuner.trials import Evaluation, EvaluationState, Outcome
from bo_tuner.tuning.observer import RunObserver

LOST_IN_A_ROW = 3
"""So many losses in a row end a run: the nodes are gone for good."""


def evaluate(
    study: Study, backend: Backend, planned: Evaluation, observer: RunObserver
) -> Evaluation:
    """Run a planned evaluation; an objective that its scale cannot take makes it a failed one.

    Parameters
    ----------
    study
        The study.
    backend
        Runs the evaluation; open.
    planned
        The evaluation, with no outcome yet.
    observer
        Told of it.

    Returns
    -------
    Evaluation
        With its outcome, and how long it took.
    """
    (evaluation,) = backend.run([planned])
    objective, outcome = study.objective, evaluation.outcome
    if outcome.state is EvaluationState.COMPLETE and objective.scale == "log":
        value = outcome.metrics[objective.metric]
        if value <= 0.0:
            reason = f"metric {objective.metric} is {value}; its log scale needs a positive value"
            failed = Outcome(EvaluationState.FAILED, {}, reason, outcome.details)
            evaluation = replace(evaluation, outcome=failed)
    observer.evaluation(evaluation)
    return evaluation


class Losses:
    """Counts what was lost with its nodes in a row, and ends the run at `LOST_IN_A_ROW`.

    Parameters
    ----------
    what
        What is counted, in the plural.
    """

    def __init__(self, what: str) -> None:
        self._what = what
        self._in_a_row = 0

    def note(self, lost: bool) -> None:
        """Count one more; one that was not lost begins a new row."""
        self._in_a_row = self._in_a_row + 1 if lost else 0

    def check(self, reason: str) -> None:
        """Raise an error if there are too many.

        Raises
        ------
        RunError
            With their number and the reason of the last one.
        """
        if self._in_a_row >= LOST_IN_A_ROW:
            raise RunError(
                f"{self._in_a_row} {self._what} in a row were lost with their nodes: {reason}"
            )
