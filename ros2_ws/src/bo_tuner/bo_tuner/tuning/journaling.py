"""The journal as an observer of the run."""

from collections.abc import Callable

from bo_tuner.optimizers.ranking import Candidate
from bo_tuner.plans import Event
from bo_tuner.storage.journal import Journal
from bo_tuner.trials import Evaluation, Trial
from bo_tuner.tuning.observer import RunObserver


class JournalObserver(RunObserver):
    """Records evaluations, trials and events, except evaluations read from the journal."""

    def __init__(self, journal: Journal, check: Callable[[], None] = lambda: None) -> None:
        self._journal = journal
        self._check = check

    def evaluation(self, evaluation: Evaluation) -> None:
        """Record an evaluation, unless it was read from the journal."""
        if not evaluation.recorded:
            self._check()
            self._journal.record_evaluation(evaluation)

    def event(self, event: Event) -> None:
        """Record a request from outside."""
        self._check()
        self._journal.record_event(event)

    def trial(self, trial: Trial, incumbent: Candidate | None) -> None:
        """Record a finished trial."""
        self._check()
        self._journal.record_trial(trial)
