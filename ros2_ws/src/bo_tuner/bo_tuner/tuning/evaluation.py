"""One evaluation: run, checked, and told to the observer."""

from dataclasses import replace

from bo_tuner.backends.protocol import Backend
from bo_tuner.errors import RunError
from bo_tuner.study.study import Study
from bo_tuner.trials import Evaluation, EvaluationState, Outcome
from bo_tuner.tuning.observer import RunObserver

LOST_IN_A_ROW = 3
"""So many in a row end a run: the nodes are gone, or not ours alone, for good."""


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
    """Counts what was spoilt in a row, see `Outcome.spoilt`, and ends the run at `LOST_IN_A_ROW`.

    Parameters
    ----------
    what
        What is counted, in the plural.
    """

    def __init__(self, what: str) -> None:
        self._what = what
        self._in_a_row: list[Outcome] = []

    def note(self, outcome: Outcome | None) -> None:
        """Count one more; one that was not spoilt, or None, begins a new row."""
        if outcome is not None and outcome.spoilt:
            self._in_a_row.append(outcome)
        else:
            self._in_a_row.clear()

    def check(self) -> None:
        """Raise an error if there are too many.

        Raises
        ------
        RunError
            With their number and the reason of the last one.
        """
        if len(self._in_a_row) < LOST_IN_A_ROW:
            return
        last = self._in_a_row[-1]
        lost = last.state is EvaluationState.LOST
        how = "lost with their nodes" if lost else "disturbed by others"
        raise RunError(f"{len(self._in_a_row)} {self._what} in a row were {how}: {last.reason}")
