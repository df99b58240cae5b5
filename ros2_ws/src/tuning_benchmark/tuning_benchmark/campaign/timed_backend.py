"""The in-process backend of campaigns, which counts."""

import time

from bo_tuner.backends.inprocess import InProcessBackend
from bo_tuner.study.study import Study
from bo_tuner.trials import Evaluation, Outcome


class TimedBackend(InProcessBackend):
    """Counts the evaluations and their processor time [s]."""

    def __init__(self, study: Study) -> None:
        super().__init__(study)
        self.evaluations = 0
        self.seconds = 0.0

    def outcome(self, planned: Evaluation) -> Outcome:
        """Run one evaluation."""
        begin = time.process_time()
        outcome = super().outcome(planned)
        self.seconds += time.process_time() - begin
        self.evaluations += 1
        return outcome
