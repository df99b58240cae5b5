"""Cuts that a run has on record already, given again instead of being run anew."""

import json
from collections.abc import Iterable

from bo_tuner.backends import Assignments, Backend
from bo_tuner.run.journal_reader import RecordedCut
from bo_tuner.study import Study
from bo_tuner.trials import Cut, CutOutcome


class RecordedCuts:
    """A backend that runs only the cuts which are not on record.

    A cut is known again by what is set for it: parametrization, context and seed of the noise. A
    run that goes on sets the same, so that it takes the way it took before.

    Parameters
    ----------
    backend
        Runs the others.
    study
        The study.
    cuts
        The record, in its order; each is given once.

    Attributes
    ----------
    backend
        The backend that runs the others.
    given
        The recorded cut behind the last outcome; None if that was run.
    """

    def __init__(self, backend: Backend, study: Study, cuts: Iterable[RecordedCut]) -> None:
        self.name = backend.name
        self.given: Cut | None = None
        self.backend = backend
        self._cuts: dict[str, list[Cut]] = {}
        for recorded in cuts:
            cut = recorded.cut
            assignments = study.assignments(recorded.parameters, cut.context, cut.seed)
            self._cuts.setdefault(_key(assignments), []).append(cut)

    def open(self) -> None:
        """Get ready to run cuts."""
        self.backend.open()

    def run_cut(self, assignments: Assignments) -> CutOutcome:
        """Give a cut from the record, or run it."""
        found = self._cuts.get(_key(assignments))
        self.given = found.pop(0) if found else None
        return self.backend.run_cut(assignments) if self.given is None else self.given.outcome

    def close(self) -> None:
        """Let go of everything that `open` took."""
        self.backend.close()


def _key(assignments: Assignments) -> str:
    # As text, 3 and 3.0 differ, as they do for a node, and all bits of a double count.
    return json.dumps({key: dict(values) for key, values in assignments.items()}, sort_keys=True)
