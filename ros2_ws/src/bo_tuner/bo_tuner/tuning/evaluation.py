"""Running one evaluation, and counting consecutive losses."""

from dataclasses import replace

from bo_tuner.backends.protocol import Backend
from bo_tuner.errors import RunError
from bo_tuner.study.study import Study
from bo_tuner.trials import Evaluation, EvaluationState, Outcome
from bo_tuner.tuning.observer import RunObserver

LOST_IN_A_ROW = 3
"""Number of consecutive losses that ends a run: the nodes are not coming back."""


def evaluate(
    study: Study, backend: Backend, planned: Evaluation, observer: RunObserver
) -> Evaluation:
    """Run a planned evaluation and pass the result to the observer.

    On a logarithmic scale, an evaluation whose objective is not positive counts as failed.

    Parameters
    ----------
    study
        The study.
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
    """Counter of consecutive losses, which ends the run at `LOST_IN_A_ROW`.

    Parameters
    ----------
    what
        What is counted, in the plural, for the error message.
    """

    def __init__(self, what: str) -> None:
        self._what = what
        self._in_a_row = 0

    def note(self, lost: bool) -> None:
        """Count a loss, or reset the counter."""
        self._in_a_row = self._in_a_row + 1 if lost else 0

    def check(self, reason: str) -> None:
        """End the run after too many losses in a row.

        Parameters
        ----------
        reason
            Of the last loss, for the error message.

        Raises
        ------
        RunError
            After `LOST_IN_A_ROW` losses in a row.
        """
        if self._in_a_row >= LOST_IN_A_ROW:
            raise RunError(
                f"{self._in_a_row} {self._what} in a row were lost with their nodes: {reason}"
            )
