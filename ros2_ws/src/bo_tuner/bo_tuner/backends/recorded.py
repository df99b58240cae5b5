"""Evaluations that a run has on record already, given again instead of being run anew."""

import json
from collections.abc import Iterable

from bo_tuner.backends.protocol import Assignments, Backend
from bo_tuner.storage.journal_reader import RecordedEvaluation
from bo_tuner.study.study import Study
from bo_tuner.trials import Evaluation, Outcome


class RecordedEvaluations:
    """A backend that runs only the evaluations which are not on record.

    An evaluation is known again by what is set for it: parameter set, context and seed of the
    noise. A run that goes on sets the same, so that it takes the way it took before.

    Parameters
    ----------
    backend
        Runs the others.
    study
        The study.
    evaluations
        The record, in its order; each is given once.

    Attributes
    ----------
    backend
        The backend that runs the others.
    given
        The recorded evaluation behind the last outcome; None if that was run.
    """

    def __init__(
        self, backend: Backend, study: Study, evaluations: Iterable[RecordedEvaluation]
    ) -> None:
        self.name = backend.name
        self.given: Evaluation | None = None
        self.backend = backend
        self._evaluations: dict[str, list[Evaluation]] = {}
        for recorded in evaluations:
            evaluation = recorded.evaluation
            assignments = study.assignments(
                recorded.parameters, evaluation.context, evaluation.seed
            )
            self._evaluations.setdefault(_key(assignments), []).append(evaluation)

    def open(self) -> None:
        """Get ready to run evaluations."""
        self.backend.open()

    def run_cut(self, assignments: Assignments) -> Outcome:
        """Give an evaluation from the record, or run it."""
        found = self._evaluations.get(_key(assignments))
        self.given = found.pop(0) if found else None
        return self.backend.run_cut(assignments) if self.given is None else self.given.outcome

    def close(self) -> None:
        """Let go of everything that `open` took."""
        self.backend.close()


def _key(assignments: Assignments) -> str:
    # As text, 3 and 3.0 differ, as they do for a node, and all bits of a double count.
    return json.dumps({key: dict(values) for key, values in assignments.items()}, sort_keys=True)
